#include "capture/v4l2_modes.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "hw/json_text.h"

namespace ruffini {
namespace {

// Limit for drivers that never report the end of a list.
constexpr uint32_t kMaxEntries = 256;

int64_t rate_mhz(const v4l2_fract& interval) {
  return interval.numerator == 0 ? 0 : int64_t{1'000} * interval.denominator / interval.numerator;
}

int64_t fastest_mhz(const VideoCalls& calls, int fd, uint32_t fourcc, int width, int height) {
  int64_t fastest = 0;
  for (uint32_t i = 0; i < kMaxEntries; ++i) {
    v4l2_frmivalenum one{};
    one.index = i;
    one.pixel_format = fourcc;
    one.width = static_cast<uint32_t>(width);
    one.height = static_cast<uint32_t>(height);
    if (calls.ioctl(fd, VIDIOC_ENUM_FRAMEINTERVALS, &one) != 0) break;
    const bool is_range = one.type != V4L2_FRMIVAL_TYPE_DISCRETE;
    fastest = std::max(fastest, rate_mhz(is_range ? one.stepwise.min : one.discrete));
    if (is_range) break;
  }
  return fastest;
}

bool is_in(int wanted, uint32_t low, uint32_t high, uint32_t step) {
  const auto number = static_cast<uint32_t>(wanted);
  return wanted > 0 && number >= low && number <= high && (step <= 1 || (number - low) % step == 0);
}

void add_sizes(const VideoCalls& calls, int fd, const V4l2Format& format, int wanted_width, int wanted_height,
               std::vector<V4l2Mode>& modes) {
  const auto add = [&](int width, int height) {
    modes.push_back({format, width, height, fastest_mhz(calls, fd, format.fourcc, width, height)});
  };
  for (uint32_t i = 0; i < kMaxEntries; ++i) {
    v4l2_frmsizeenum one{};
    one.index = i;
    one.pixel_format = format.fourcc;
    if (calls.ioctl(fd, VIDIOC_ENUM_FRAMESIZES, &one) != 0) {
      // A driver without the list may still support the size: its answer to the request decides.
      if (i == 0 && errno == ENOTTY && wanted_width > 0) modes.push_back({format, wanted_width, wanted_height, 0});
      return;
    }
    if (one.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
      add(static_cast<int>(one.discrete.width), static_cast<int>(one.discrete.height));
      continue;
    }
    const v4l2_frmsize_stepwise& range = one.stepwise;
    const bool is_there = is_in(wanted_width, range.min_width, range.max_width, range.step_width) &&
                          is_in(wanted_height, range.min_height, range.max_height, range.step_height);
    add(is_there ? wanted_width : static_cast<int>(range.max_width),
        is_there ? wanted_height : static_cast<int>(range.max_height));
    return;
  }
}

std::string decimal(int64_t thousandths) {
  const std::string whole = std::to_string(thousandths / 1'000);
  return thousandths % 1'000 == 0 ? whole : whole + "." + std::to_string(1'000 + thousandths % 1'000).substr(1);
}

std::string mode_text(const V4l2Mode& mode) {
  return text_of(mode.format.fourcc) + " " + std::to_string(mode.width_px) + "x" + std::to_string(mode.height_px) +
         (mode.rate_mhz == 0 ? "" : " at up to " + decimal(mode.rate_mhz));
}

}  // namespace

const std::array<V4l2Format, 8>& v4l2_formats() {
  static const std::array<V4l2Format, 8> kFormats = {{{V4L2_PIX_FMT_BGR24, PixelLayout::kBgr},
                                                      {V4L2_PIX_FMT_RGB24, PixelLayout::kRgb},
                                                      {V4L2_PIX_FMT_XBGR32, PixelLayout::kBgrx},
                                                      {V4L2_PIX_FMT_YUYV, PixelLayout::kYuyv},
                                                      {V4L2_PIX_FMT_NV12, PixelLayout::kNv12},
                                                      {V4L2_PIX_FMT_MJPEG, std::nullopt},
                                                      {V4L2_PIX_FMT_JPEG, std::nullopt},
                                                      {V4L2_PIX_FMT_GREY, PixelLayout::kGrey}}};
  return kFormats;
}

std::string text_of(uint32_t fourcc) {
  std::string text;
  for (int shift = 0; shift < 32; shift += 8) {
    const auto byte = static_cast<unsigned char>(fourcc >> shift);
    text += byte >= 0x20 && byte < 0x7f ? static_cast<char>(byte) : '?';
  }
  return text;
}

std::vector<V4l2Mode> v4l2_modes(const VideoCalls& calls, int fd, int wanted_width, int wanted_height) {
  std::vector<uint32_t> offered;
  for (uint32_t i = 0; i < kMaxEntries; ++i) {
    v4l2_fmtdesc one{};
    one.index = i;
    one.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (calls.ioctl(fd, VIDIOC_ENUM_FMT, &one) != 0) break;
    offered.push_back(one.pixelformat);
  }
  std::vector<V4l2Mode> modes;
  for (const V4l2Format& format : v4l2_formats()) {
    if (std::find(offered.begin(), offered.end(), format.fourcc) == offered.end()) continue;
    add_sizes(calls, fd, format, wanted_width, wanted_height, modes);
  }
  return modes;
}

Result<std::vector<V4l2Mode>> fitting_modes(const std::vector<V4l2Mode>& offered, const CameraSettings& wanted,
                                            const std::string& camera) {
  // 29.97 counts as 30.
  const auto is_fast = [&wanted](const V4l2Mode& mode) {
    return mode.rate_mhz == 0 || 100 * mode.rate_mhz >= 98 * wanted.rate_mhz;
  };
  std::vector<V4l2Mode> fitting;
  std::string seen;
  bool has_size = false;
  for (const V4l2Mode& mode : offered) {
    const bool is_size = mode.width_px == wanted.width_px && mode.height_px == wanted.height_px;
    has_size = has_size || is_size;
    seen += (seen.empty() ? "" : ", ") + mode_text(mode);
    if (is_size && is_fast(mode)) fitting.push_back(mode);
  }
  if (!fitting.empty()) return fitting;
  if (seen.empty()) {
    return Error{ErrorKind::kBadInput, "camera " + camera +
                                           " offers none of the formats BGR24, RGB24, YUYV, NV12, MJPG and GREY: use "
                                           "another camera"};
  }
  const std::string size = std::to_string(wanted.width_px) + "x" + std::to_string(wanted.height_px);
  return Error{ErrorKind::kBadInput,
               "camera " + camera + (has_size ? " is too slow: " : " has no picture of that size: ") +
                   "board.toml asks for " + decimal(wanted.rate_mhz) + " frames a second of " + size + ", it offers " +
                   seen + (has_size ? ": a USB 3 port may offer more" : "")};
}

YuvRule rule_of(const v4l2_pix_format& format) {
  const bool has_encoding = format.ycbcr_enc != V4L2_YCBCR_ENC_DEFAULT;
  const auto encoding = static_cast<uint32_t>(has_encoding ? static_cast<v4l2_ycbcr_encoding>(format.ycbcr_enc)
                                                           : V4L2_MAP_YCBCR_ENC_DEFAULT(format.colorspace));
  const bool has_range = format.quantization != V4L2_QUANTIZATION_DEFAULT;
  const auto range =
      static_cast<uint32_t>(has_range ? static_cast<v4l2_quantization>(format.quantization)
                                      : V4L2_MAP_QUANTIZATION_DEFAULT(false, format.colorspace, encoding));
  const bool is_full = range == V4L2_QUANTIZATION_FULL_RANGE;
  if (encoding == V4L2_YCBCR_ENC_709) return is_full ? kFull709 : kLimited709;
  return is_full ? kFull601 : kLimited601;
}

std::string capture_refusal(const VideoCalls& calls, int fd, std::string& driver) {
  v4l2_capability about{};
  if (calls.ioctl(fd, VIDIOC_QUERYCAP, &about) != 0)
    return "is not a V4L2 device: ruffinid --list-cameras shows those that are";
  driver = reinterpret_cast<const char*>(about.driver);
  const uint32_t can = (about.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? about.device_caps : about.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0) {
    return "captures in several planes only, as the camera of a board does: use --camera libcamera:";
  }
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0) return "is not a capture device: a camera has another node for its pictures";
  if ((can & V4L2_CAP_STREAMING) == 0) return "does not stream into memory: use another camera";
  return {};
}

std::string cameras_json(const VideoCalls& calls) {
  std::string out = "{\"cameras\": [";
  bool is_first = true;
  for (const VideoNode& node : calls.nodes()) {
    std::string problem;
    std::vector<V4l2Mode> modes;
    if (const int fd = calls.open(node.path); fd >= 0) {
      std::string driver;
      problem = capture_refusal(calls, fd, driver);
      if (problem.empty()) modes = v4l2_modes(calls, fd, 0, 0);
      calls.close(fd);
      if (!problem.empty()) continue;  // a metadata or codec node
    } else {
      problem = std::strerror(errno);
    }
    out += (is_first ? "" : ", ") + std::string("{\"path\": ") + json_quoted(node.path) +
           ", \"name\": " + json_quoted(node.name) + ", \"serial\": " + json_quoted(node.serial) +
           ", \"vendor\": " + std::to_string(node.vendor) + ", \"product\": " + std::to_string(node.product) +
           ", \"problem\": " + json_quoted(problem) + ", \"modes\": [";
    for (size_t i = 0; i < modes.size(); ++i) {
      out += (i == 0 ? "" : ", ") + std::string("{\"format\": ") + json_quoted(text_of(modes[i].format.fourcc)) +
             ", \"width_px\": " + std::to_string(modes[i].width_px) +
             ", \"height_px\": " + std::to_string(modes[i].height_px) +
             ", \"rate_mhz\": " + std::to_string(modes[i].rate_mhz) + "}";
    }
    out += "]}";
    is_first = false;
  }
  return out + "]}";
}

}  // namespace ruffini
