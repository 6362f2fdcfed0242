// What a V4L2 device offers: whether it captures, and its formats with their sizes and rates.
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

// A format that we read. No layout: Motion JPEG.
struct V4l2Format {
  uint32_t fourcc;
  std::optional<PixelLayout> layout;
};
// Dearest first: no loss before loss, colour before grey.
[[nodiscard]] const std::array<V4l2Format, 8>& v4l2_formats();
[[nodiscard]] std::string text_of(uint32_t fourcc);

struct V4l2Mode {
  V4l2Format format;
  int width_px;
  int height_px;
  int64_t rate_mhz;  // at most; 0: not told
};

// Modes in formats that we read, in the order of v4l2_formats(). Of a range of sizes: the wanted one where it is in it,
// else the largest.
[[nodiscard]] std::vector<V4l2Mode> v4l2_modes(const VideoCalls& calls, int fd, int wanted_width, int wanted_height);
// Those of the board's size that are fast enough. Errors: kBadInput, with what there is.
[[nodiscard]] Result<std::vector<V4l2Mode>> fitting_modes(const std::vector<V4l2Mode>& offered,
                                                          const CameraSettings& wanted, const std::string& camera);

[[nodiscard]] YuvRule rule_of(const v4l2_pix_format& format);

// Why it is no camera for us; empty: it is one. `driver` is its driver's name.
[[nodiscard]] std::string why_no_capture(const VideoCalls& calls, int fd, std::string& driver);

// The cameras of this computer as one line of JSON: path, name, serial, vendor, product, problem, modes.
[[nodiscard]] std::string cameras_json(const VideoCalls& calls);

}  // namespace ruffini
