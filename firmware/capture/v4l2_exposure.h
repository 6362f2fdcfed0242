// [exposure] of a camera by the controls of its V4L2 device: all of it for v4l2_camera.h; for libcamera_camera.h what its
// pipeline for USB neither sets nor tells, since libcamera leaves the device open to others.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

// As the device says; empty: it has no such control, or does not answer.
struct V4l2Exposure {
  std::optional<int32_t> mode;  // V4L2_EXPOSURE_*
  std::optional<int32_t> time_100us;
  std::optional<int32_t> gain;  // in the device's own unit
  std::optional<int32_t> is_white_auto;
  std::optional<int32_t> white_kelvin;
};

// What is not as [exposure] asks; of the gain, whose unit is the device's own, whether it is still that of `first`.
// What is not told is not judged.
[[nodiscard]] std::string drift_of(const V4l2Exposure& said, const V4l2Exposure& first, const ExposureSettings& asked);

// A gain of [exposure] in a device's own unit, as libcamera counts it: the default is 1, the maximum 4; where the minimum
// would come below 0.5 so, the minimum is 0.5 instead. nullopt: the device has no such gain.
[[nodiscard]] std::optional<int32_t> device_gain(int64_t gain_1e3, int32_t minimum, int32_t maximum, int32_t otherwise);

class V4l2Controls {
 public:
  using Ioctl = std::function<int(unsigned long request, void* argument)>;

  // Sets white_kelvin, the automatic off, of the device at `path`; `camera` is for messages. Errors: kUnavailable (no
  // such device), kBadInput (it cannot be told the colour, or not this one).
  [[nodiscard]] static Result<V4l2Controls> open(const std::string& camera, const std::string& path,
                                                 const ExposureSettings& asked);
  // Sets everything that `asked` (is_manual()) says, the automatics off. Errors: kBadInput, with each number that the
  // device cannot be told and its limits.
  [[nodiscard]] static Result<V4l2Controls> set(const std::string& camera, Ioctl device, const ExposureSettings& asked);

  // drift_of what the device says, asked at most once a second: each number is a transfer to the camera. The first
  // call is to come when the controls are in force; after open() it takes the gain for what was asked.
  [[nodiscard]] const std::string& drift(std::chrono::steady_clock::time_point now);

 private:
  V4l2Controls(Ioctl device, const ExposureSettings& asked) : device_(std::move(device)), asked_(asked) {}
  [[nodiscard]] V4l2Exposure read() const;

  Ioctl device_;
  ExposureSettings asked_;
  std::optional<V4l2Exposure> first_;
  std::chrono::steady_clock::time_point due_;
  std::string drift_;
};

}  // namespace ruffini
