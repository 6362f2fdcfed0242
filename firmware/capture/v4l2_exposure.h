// Sets and checks [exposure] through the controls of a V4L2 device: completely for v4l2_camera.h, and for
// libcamera_camera.h the part that its USB pipeline neither sets nor reports, since libcamera leaves the device
// accessible to others.
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

// Values reported by the device; empty: it has no such control, or does not answer.
struct V4l2Exposure {
  std::optional<int32_t> mode;  // V4L2_EXPOSURE_*
  std::optional<int32_t> time_100us;
  std::optional<int32_t> gain;  // in the device's own unit
  std::optional<int32_t> is_white_auto;
  std::optional<int32_t> white_kelvin;
};

// Describes how the reported values differ from [exposure]. The gain, whose unit is the device's own, must equal that
// of `first`. Values that are not reported are not checked.
[[nodiscard]] std::string drift_of(const V4l2Exposure& said, const V4l2Exposure& first, const ExposureSettings& asked);

// Converts a gain of [exposure] to a device's own unit by libcamera's rule: the default is 1, the maximum 4; if the
// minimum would be below 0.5, the minimum is 0.5 instead. Returns nullopt if the device has no such gain.
[[nodiscard]] std::optional<int32_t> device_gain(int64_t gain_1e3, int32_t minimum, int32_t maximum, int32_t otherwise);

class V4l2Controls {
 public:
  using Ioctl = std::function<int(unsigned long request, void* argument)>;

  // Sets white_kelvin, with the automatic off, on the device at `path`. `camera`: name for messages. Errors:
  // kUnavailable (no such device), kBadInput (the colour, or this value, is not supported).
  [[nodiscard]] static Result<V4l2Controls> open(const std::string& camera, const std::string& path,
                                                 const ExposureSettings& asked);
  // Sets everything that `asked` (is_manual()) contains, with the automatics off. Errors: kBadInput, listing each
  // unsupported value and its limits.
  [[nodiscard]] static Result<V4l2Controls> set(const std::string& camera, Ioctl device, const ExposureSettings& asked);

  // Returns drift_of() the device's values, queried at most once a second, because each value is a USB transfer. Call
  // it first when the controls are in force; after open() the first gain read is taken as the reference.
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
