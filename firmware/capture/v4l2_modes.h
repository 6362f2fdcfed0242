// Queries a V4L2 device: whether it captures, and its formats with sizes and rates.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "capture/pixels.h"
#include "capture/video_calls.h"

struct v4l2_pix_format;

namespace ruffini {

// A supported format. Without a layout it is Motion JPEG.
struct V4l2Format {
  uint32_t fourcc;
  std::optional<PixelLayout> layout;
};
// In order of preference: lossless before lossy, colour before grey.
[[nodiscard]] const std::array<V4l2Format, 8>& v4l2_formats();
[[nodiscard]] std::string text_of(uint32_t fourcc);

struct V4l2Mode {
  V4l2Format format;
  int width_px;
  int height_px;
  int64_t rate_mhz;  // maximum; 0: not reported
};

// Modes in supported formats, in the order of v4l2_formats(). For a range of sizes: the wanted size if it is in the
// range, else the largest.
[[nodiscard]] std::vector<V4l2Mode> v4l2_modes(const VideoCalls& calls, int fd, int wanted_width, int wanted_height);
// Modes with the board's size that are fast enough. Errors: kBadInput, listing the available modes.
[[nodiscard]] Result<std::vector<V4l2Mode>> fitting_modes(const std::vector<V4l2Mode>& offered,
                                                          const CameraSettings& wanted, const std::string& camera);

[[nodiscard]] YuvRule rule_of(const v4l2_pix_format& format);

// Why the device cannot be used as a camera; empty: it can. Writes the driver's name to `driver`.
[[nodiscard]] std::string capture_refusal(const VideoCalls& calls, int fd, std::string& driver);

// The cameras of this computer as one line of JSON: path, name, serial, vendor, product, problem, modes.
[[nodiscard]] std::string cameras_json(const VideoCalls& calls);

}  // namespace ruffini
