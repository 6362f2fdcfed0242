// Exposure of a camera on USB: what libcamera's pipeline for it (uvcvideo) neither sets nor tells, by the controls of its
// V4L2 device, which libcamera leaves open to others.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "base/result.h"
#include "base/unique_fd.h"
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

class V4l2Controls {
 public:
  // Sets white_kelvin, the automatic off, of the device at `path`; `camera` is for messages. Errors: kUnavailable (no
  // such device), kBadInput (it cannot be told the colour, or not this one).
  [[nodiscard]] static Result<V4l2Controls> open(const std::string& camera, const std::string& path,
                                                 const ExposureSettings& asked);

  // drift_of what the device says, asked at most once a second: each number is a transfer to the camera. The first
  // call, which is to come when the controls are in force, takes the gain for what was asked.
  [[nodiscard]] const std::string& drift();

 private:
  V4l2Controls(UniqueFd fd, const ExposureSettings& asked) : fd_(std::move(fd)), asked_(asked) {}
  [[nodiscard]] V4l2Exposure read() const;

  UniqueFd fd_;
  ExposureSettings asked_;
  std::optional<V4l2Exposure> first_;
  std::chrono::steady_clock::time_point due_;
  std::string drift_;
};

}  // namespace ruffini
