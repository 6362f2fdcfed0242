#include "capture/v4l2_camera.h"

#include <linux/videodev2.h>
#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "capture/jpeg.h"
#include "capture/pixels.h"
#include "capture/stream_limits.h"
#include "capture/v4l2_exposure.h"
#include "capture/v4l2_modes.h"

namespace ruffini {
namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr uint32_t kBuffers = 4;

struct Mapping {
  uint8_t* data;
  size_t n_bytes;
};

v4l2_buffer of_memory(uint32_t index) {
  v4l2_buffer buffer{};
  buffer.index = index;
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  return buffer;
}

std::string usb_identity(const VideoNode& node) {
  constexpr const char* kDigits = "0123456789abcdef";
  std::string text;
  for (const int number : {node.vendor, node.product}) {
    text += text.empty() ? "" : ":";
    for (int shift = 12; shift >= 0; shift -= 4) text += kDigits[(number >> shift) & 0xf];
  }
  return text;
}

bool is_named(const VideoNode& node, const std::string& name) {
  return node.name.find(name) != std::string::npos || (!node.serial.empty() && node.serial == name) ||
         (node.vendor != 0 && usb_identity(node) == name);
}

std::string list_of(const std::vector<VideoNode>& nodes) {
  std::string text;
  for (const VideoNode& node : nodes) {
    text += (text.empty() ? "" : ", ") + node.path + " (" + node.name +
            (node.serial.empty() ? "" : ", serial number " + node.serial) + ")";
  }
  return text.empty() ? "none" : text;
}

class V4l2Camera : public Camera {
 public:
  V4l2Camera(const BoardSettings& board, VideoCalls calls) : board_(board), calls_(std::move(calls)) {}
  V4l2Camera(V4l2Camera&&) = delete;
  ~V4l2Camera() override {
    if (fd_ < 0) return;
    free_buffers();
    calls_.close(fd_);
  }

  Status open(const std::string& name) {
    if (Status found = find(name); !found) return found;
    if (Status opened = open_node(); !opened) return opened;
    std::string driver;
    if (const std::string why = capture_refusal(calls_, fd_, driver); !why.empty()) {
      return Error{ErrorKind::kBadInput, "camera " + id_ + " " + why};
    }
    is_simulated_ = driver == "vivid" || driver == "vimc";  // drivers of the kernel that generate their pictures
    // Drivers whose format cannot change do not have this event.
    v4l2_event_subscription change{};
    change.type = V4L2_EVENT_SOURCE_CHANGE;
    calls_.ioctl(fd_, VIDIOC_SUBSCRIBE_EVENT, &change);
    return start_in_some_mode();
  }

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (!problem_.empty()) return CaptureStatus::kEnd;
    const int events = calls_.poll(fd_, kFrameWait);
    if (events > 0 && (events & POLLPRI) != 0 && has_changed()) {
      return end("changed the size of its picture: start ruffinid again");
    }
    int failed = 0;
    const std::optional<v4l2_buffer> frame = newest(failed);
    if (!frame) return without_frame(failed);
    n_restarts_ = 0;
    last_frame_ = calls_.now();
    const CaptureStatus status = take(*frame, buffer);
    queue(frame->index);
    return status;
  }
  [[nodiscard]] std::string problem() const override { return problem_; }
  [[nodiscard]] bool is_simulated() const override { return is_simulated_; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  [[nodiscard]] Error unavailable(const std::string& why) const {
    return {ErrorKind::kUnavailable, "camera " + id_ + " " + why};
  }

  // True if a node with a matching name is a camera. A node that may not be opened counts: opening it reports the
  // error.
  [[nodiscard]] bool captures(const VideoNode& node) const {
    const int fd = calls_.open(node.path);
    if (fd < 0) return errno == EACCES || errno == EPERM;
    std::string driver;
    const bool does = capture_refusal(calls_, fd, driver).empty();
    calls_.close(fd);
    return does;
  }

  Status find(const std::string& name) {
    path_ = id_ = name;
    if (!name.empty() && name.front() == '/') return Unit{};
    const std::vector<VideoNode> nodes = calls_.nodes();
    std::vector<VideoNode> fitting;
    for (const VideoNode& node : nodes) {
      if (is_named(node, name) && captures(node)) fitting.push_back(node);
    }
    if (fitting.empty()) {
      return unavailable("is not there: this computer has " + list_of(nodes) + "; look at its cable, then dmesg");
    }
    if (fitting.size() > 1) {
      return Error{ErrorKind::kBadInput, "several cameras: choose one with --camera v4l2:PATH of " + list_of(fitting)};
    }
    path_ = fitting.front().path;
    id_ = fitting.front().name + " (" + path_ + ")";
    return Unit{};
  }

  Status open_node() {
    fd_ = calls_.open(path_);
    if (fd_ >= 0) return Unit{};
    switch (errno) {
      case EACCES:
      case EPERM:
        return unavailable("may not be opened by this user: sudo usermod -aG video $USER, then log in again");
      case EBUSY:
        return unavailable(kBusy + path_ + ")");
      case ENOENT:
      case ENODEV:
      case ENXIO:
        return unavailable("is not there: this computer has " + list_of(calls_.nodes()));
      default:
        return unavailable("does not open: " + std::string(std::strerror(errno)));
    }
  }

  // Selects the first matching mode that starts: drivers accept formats in which they then do not stream.
  Status start_in_some_mode() {
    const auto modes =
        fitting_modes(v4l2_modes(calls_, fd_, board_.camera.width_px, board_.camera.height_px), board_.camera, id_);
    if (!modes) return modes.error();
    Error last = unavailable("did not start");
    for (const V4l2Mode& mode : modes.value()) {
      Status started = configure(mode);
      if (started) started = make_buffers();
      if (started) started = add_exposure_controls();
      if (started) started = start(text_of(mode.format.fourcc));
      if (started) return started;
      free_buffers();
      last = started.error();
    }
    return last;
  }

  Status configure(const V4l2Mode& mode) {
    v4l2_format format{};
    format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    v4l2_pix_format& picture = format.fmt.pix;
    picture.width = static_cast<uint32_t>(board_.camera.width_px);
    picture.height = static_cast<uint32_t>(board_.camera.height_px);
    picture.pixelformat = mode.format.fourcc;
    picture.field = V4L2_FIELD_NONE;
    if (calls_.ioctl(fd_, VIDIOC_S_FMT, &format) != 0) return refused("takes no format");
    const bool is_wanted = picture.pixelformat == mode.format.fourcc &&
                           picture.width == static_cast<uint32_t>(board_.camera.width_px) &&
                           picture.height == static_cast<uint32_t>(board_.camera.height_px);
    if (!is_wanted || picture.field != V4L2_FIELD_NONE) {
      return Error{ErrorKind::kBadInput, "camera " + id_ + " gives " + text_of(picture.pixelformat) + " of " +
                                             std::to_string(picture.width) + "x" + std::to_string(picture.height) +
                                             (picture.field == V4L2_FIELD_NONE ? "" : " in interlaced fields") +
                                             " where " + text_of(mode.format.fourcc) +
                                             " of the board's size was asked: use another camera or board"};
    }
    layout_ = mode.format.layout;
    rule_ = rule_of(picture);
    stride_ = std::max<size_t>(picture.bytesperline, least_stride());
    return ask_rate();
  }

  [[nodiscard]] size_t least_stride() const {
    const auto width = static_cast<size_t>(board_.camera.width_px);
    switch (layout_.value_or(PixelLayout::kGrey)) {
      case PixelLayout::kBgr:
      case PixelLayout::kRgb:
        return 3 * width;
      case PixelLayout::kBgrx:
        return 4 * width;
      case PixelLayout::kYuyv:
        return 2 * width;
      case PixelLayout::kNv12:
      case PixelLayout::kGrey:
        break;
    }
    return width;
  }

  // A camera without this request has a fixed rate.
  Status ask_rate() {
    const int64_t wanted_mhz = board_.camera.rate_mhz;
    period_ = std::chrono::microseconds(1'000'000'000 / wanted_mhz);
    v4l2_streamparm rate{};
    rate.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    rate.parm.capture.timeperframe = {1'000, static_cast<uint32_t>(wanted_mhz)};
    int64_t got_mhz = 0;
    if (calls_.ioctl(fd_, VIDIOC_S_PARM, &rate) == 0 && rate.parm.capture.timeperframe.numerator != 0) {
      const v4l2_fract& each = rate.parm.capture.timeperframe;
      got_mhz = int64_t{1'000} * each.denominator / each.numerator;
    }
    is_paced_here_ = got_mhz == 0 || 98 * got_mhz > 100 * wanted_mhz;
    own_period_us_ = got_mhz == 0 ? 0 : static_cast<uint64_t>(1'000'000'000 / got_mhz);
    return Unit{};
  }

  Status make_buffers() {
    v4l2_requestbuffers request{};
    request.count = kBuffers;
    request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    request.memory = V4L2_MEMORY_MMAP;
    if (calls_.ioctl(fd_, VIDIOC_REQBUFS, &request) != 0) return refused("gives no frame memory");
    for (uint32_t i = 0; i < request.count; ++i) {
      v4l2_buffer buffer = of_memory(i);
      if (calls_.ioctl(fd_, VIDIOC_QUERYBUF, &buffer) != 0) return refused("gives no frame memory");
      uint8_t* data = calls_.map(fd_, buffer.length, buffer.m.offset);
      if (data == nullptr) return refused("gives no frame memory");
      mappings_.push_back({data, buffer.length});
    }
    if (mappings_.size() < 2) return unavailable("gives less than two frames of memory: is memory free?");
    return Unit{};
  }

  Status add_exposure_controls() {
    if (!board_.exposure.is_manual()) return Unit{};
    auto set = V4l2Controls::set(
        id_, [this](unsigned long request, void* argument) { return calls_.ioctl(fd_, request, argument); },
        board_.exposure);
    if (!set) return set.error();
    controls_ = std::move(set).value();
    return Unit{};
  }

  Status start(const std::string& format) {
    for (uint32_t i = 0; i < mappings_.size(); ++i) {
      if (!queue(i)) return refused("takes no frame memory");
    }
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (calls_.ioctl(fd_, VIDIOC_STREAMON, &type) != 0) {
      if (errno != ENOSPC) return refused("did not start");
      return unavailable("has no room on its USB bus for " + format +
                         " of that size and rate: give it a USB 3 port, or one that it shares with no other camera");
    }
    n_settling_ = kSettlingFrames;
    has_sequence_ = false;
    last_frame_ = calls_.now();
    return Unit{};
  }

  // Message for a failed call, by errno.
  [[nodiscard]] Error refused(const std::string& what) const {
    if (errno == EBUSY) return unavailable(kBusy + path_ + ")");
    if (errno == ENODEV) return unavailable("was unplugged");
    return unavailable(what + ": " + std::strerror(errno) + "; dmesg says more");
  }

  bool queue(uint32_t index) {
    v4l2_buffer buffer = of_memory(index);
    return calls_.ioctl(fd_, VIDIOC_QBUF, &buffer) == 0;
  }

  void stop() {
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    calls_.ioctl(fd_, VIDIOC_STREAMOFF, &type);  // returns all buffers, even from a camera that was unplugged
  }

  void free_buffers() {
    stop();
    for (const Mapping& mapping : mappings_) calls_.unmap(mapping.data, mapping.n_bytes);
    mappings_.clear();
    v4l2_requestbuffers none{};
    none.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    none.memory = V4L2_MEMORY_MMAP;
    calls_.ioctl(fd_, VIDIOC_REQBUFS, &none);
  }

  // Returns the newest waiting frame; older ones return to the driver. `failed`: errno if there is none.
  std::optional<v4l2_buffer> newest(int& failed) {
    std::optional<v4l2_buffer> taken;
    for (uint32_t i = 0; i < kBuffers; ++i) {
      v4l2_buffer one = of_memory(0);
      if (calls_.ioctl(fd_, VIDIOC_DQBUF, &one) != 0) {
        failed = errno;
        break;
      }
      if (one.index >= mappings_.size()) continue;  // not one of ours: no driver does this
      if (taken) queue(taken->index);
      taken = one;
    }
    return taken;
  }

  bool has_changed() {
    v4l2_event event{};
    return calls_.ioctl(fd_, VIDIOC_DQEVENT, &event) == 0 && event.type == V4L2_EVENT_SOURCE_CHANGE &&
           (event.u.src_change.changes & V4L2_EVENT_SRC_CH_RESOLUTION) != 0;
  }

  [[nodiscard]] bool is_gone() const {
    v4l2_capability about{};
    return calls_.ioctl(fd_, VIDIOC_QUERYCAP, &about) != 0;
  }

  CaptureStatus without_frame(int failed) {
    if (failed == ENODEV || (failed != EAGAIN && is_gone())) return end("was unplugged");
    const bool is_silent = calls_.now() - last_frame_ >= longest_silence(period_, n_restarts_);
    if (failed == EAGAIN && !is_silent) return CaptureStatus::kNothing;
    if (is_gone()) return end("was unplugged");
    if (++n_restarts_ > kMaxRestarts) return end("gives no frames, though it was started again: dmesg says more");
    stop();
    if (const Status started = start("frames"); !started) {
      problem_ = started.error().message;
      return CaptureStatus::kEnd;
    }
    return CaptureStatus::kNothing;
  }

  CaptureStatus end(const std::string& why) {
    problem_ = "camera " + id_ + " " + why;
    return CaptureStatus::kEnd;
  }

  CaptureStatus take(const v4l2_buffer& frame, FramePool::Buffer& buffer) {
    // Frames of a faster camera that are skipped are not missing. FrameOrder handles a driver that counts backwards.
    const int32_t step =
        has_sequence_ && !is_paced_here_ ? static_cast<int32_t>(frame.sequence - sequence_) : int32_t{1};
    const uint64_t middle = middle_us(frame);
    if (n_settling_ > 0 && board_.exposure.is_manual()) {
      --n_settling_;
      return CaptureStatus::kNothing;
    }
    if (is_too_soon(middle)) return CaptureStatus::kNothing;
    has_sequence_ = true;
    sequence_ = frame.sequence;
    number_ = std::max<int64_t>(number_ + step, 0);
    buffer.number = static_cast<uint64_t>(number_);
    buffer.capture_us = middle;
    const std::string drift = controls_ ? controls_->drift(calls_.now()) : std::string();
    n_drifted_ = drift.empty() ? 0 : n_drifted_ + 1;
    if (n_drifted_ >= kMaxDrifted) return end("has " + drift + ": give [exposure] numbers that it can keep");
    if (!drift.empty()) return CaptureStatus::kInvalidFrame;
    const bool is_whole = (frame.flags & V4L2_BUF_FLAG_ERROR) == 0 && copy(frame, buffer.pixels.data());
    n_damaged_ = is_whole ? 0 : n_damaged_ + 1;
    if (n_damaged_ >= kMaxDamaged) return end("gives only damaged frames: try another cable or port, without a hub");
    return is_whole ? CaptureStatus::kFrame : CaptureStatus::kInvalidFrame;
  }

  [[nodiscard]] uint64_t middle_us(const v4l2_buffer& frame) const {
    if ((frame.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) return 0;
    const int64_t stamp_us = int64_t{1'000'000} * frame.timestamp.tv_sec + frame.timestamp.tv_usec;
    const bool is_of_start = (frame.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    const int64_t half_us = board_.exposure.time_us / 2;
    return static_cast<uint64_t>(std::max<int64_t>(stamp_us + (is_of_start ? half_us : -half_us), 0));
  }

  // Selects the camera's frame nearest to the board's time.
  bool is_too_soon(uint64_t stamp_us) {
    if (!is_paced_here_ || stamp_us == 0) return false;
    if (stamp_us + own_period_us_ / 2 < due_us_) return true;
    const auto period_us =
        static_cast<uint64_t>(std::chrono::duration_cast<std::chrono::microseconds>(period_).count());
    due_us_ = std::max(due_us_ + period_us, stamp_us + period_us / 2);
    return false;
  }

  // Returns false if the data is shorter than a picture.
  bool copy(const v4l2_buffer& frame, uint8_t* out) {
    const Mapping& mapping = mappings_[frame.index];
    const int width = board_.camera.width_px;
    const int height = board_.camera.height_px;
    const size_t n_bytes = std::min<size_t>(frame.bytesused, mapping.n_bytes);
    if (!layout_) return jpeg_.decode(mapping.data, n_bytes, width, height, out);
    const size_t luma = stride_ * static_cast<size_t>(height);
    // The last row may lack its padding.
    const size_t least = *layout_ == PixelLayout::kNv12 ? luma + luma / 2 : luma - stride_ + least_stride();
    if (n_bytes < least) return false;
    const auto stride = static_cast<ptrdiff_t>(stride_);
    to_bgr(*layout_, rule_, {{mapping.data, mapping.data + luma}, {stride, stride}}, width, height, out);
    return true;
  }

  static inline const std::string kBusy = "is used by another program: end that one (fuser ";

  BoardSettings board_;
  VideoCalls calls_;
  int fd_ = -1;
  std::string path_;
  std::string id_;
  std::string problem_;
  bool is_simulated_ = false;
  std::optional<PixelLayout> layout_;  // no value: Motion JPEG
  YuvRule rule_ = kFull601;
  size_t stride_ = 0;
  JpegDecoder jpeg_;
  std::vector<Mapping> mappings_;
  std::optional<V4l2Controls> controls_;
  SteadyClock::duration period_{};
  bool is_paced_here_ = false;
  uint64_t own_period_us_ = 0;  // 0: not reported
  uint64_t due_us_ = 0;
  SteadyClock::time_point last_frame_;
  int n_settling_ = 0;
  int n_drifted_ = 0;
  int n_damaged_ = 0;
  int n_restarts_ = 0;
  bool has_sequence_ = false;
  uint32_t sequence_ = 0;
  int64_t number_ = 0;
};

}  // namespace

Result<std::unique_ptr<Camera>> open_v4l2(const std::string& name, const BoardSettings& board, VideoCalls calls) {
  auto camera = std::make_unique<V4l2Camera>(board, std::move(calls));
  if (Status opened = camera->open(name); !opened) return opened.error();
  return std::unique_ptr<Camera>(std::move(camera));
}

}  // namespace ruffini
