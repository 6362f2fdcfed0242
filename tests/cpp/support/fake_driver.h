// A V4L2 driver in memory for tests: formats, controls, frames and faults as a test lists them, on a clock of its own.
#pragma once

#include <linux/videodev2.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "capture/video_calls.h"

namespace ruffini::test {

struct FakeMode {
  uint32_t fourcc;
  uint32_t width;
  uint32_t height;
  uint32_t rate_hz;
};

struct FakeFrame {
  std::vector<uint8_t> bytes{};
  uint32_t sequence = 0;
  uint64_t stamp_us = 0;
  uint32_t flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  int error = 0;  // errno of VIDIOC_DQBUF in place of a frame
};

struct FakeControl {
  int32_t minimum;
  int32_t maximum;
  int32_t otherwise;
  int32_t now;
};

// One device, at each path. Frames come in order, one each time that it is waited for.
class FakeDriver {
 public:
  std::vector<VideoNode> nodes{
      {.path = "/dev/video0", .name = "Test Cam", .serial = "S-1", .vendor = 0x1d6b, .product = 0x102}};
  std::vector<FakeMode> modes{};
  std::map<uint32_t, FakeControl> controls{};
  std::deque<FakeFrame> frames{};
  int open_error = 0;
  std::map<unsigned long, std::deque<int>> errors{};  // errno of the next calls of a request; 0: it works
  uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  uint32_t given_width = 0;  // by S_FMT in place of what was asked
  uint32_t field = V4L2_FIELD_NONE;
  uint32_t least_rate_hz = 0;  // of S_PARM
  bool is_gone = false;
  bool changes_size = false;
  std::chrono::steady_clock::time_point now{std::chrono::seconds{100}};
  std::chrono::milliseconds waited{0};
  int n_starts = 0;
  int n_open = 0;
  int n_mapped = 0;

  VideoCalls calls() {
    VideoCalls made;
    made.nodes = [this] { return nodes; };
    made.open = [this](const std::string& path) {
      const bool is_there = std::any_of(nodes.begin(), nodes.end(), [&](const VideoNode& n) { return n.path == path; });
      errno = open_error != 0 ? open_error : is_there ? 0 : ENOENT;
      if (errno != 0) return -1;
      ++n_open;
      return 7;
    };
    made.close = [this](int) { return --n_open, 0; };
    made.map = [this](int, size_t, int64_t offset) {
      ++n_mapped;
      return memory_.at(static_cast<size_t>(offset)).data();
    };
    made.unmap = [this](uint8_t*, size_t) { --n_mapped; };
    made.poll = [this](int, std::chrono::milliseconds longest) {
      if (changes_size) return int{POLLPRI};
      is_due_ = !frames.empty();
      if (is_due_) return int{POLLIN};
      now += longest;
      waited += longest;
      return 0;
    };
    made.now = [this] { return now; };
    made.ioctl = [this](int, unsigned long request, void* argument) {
      errno = answer(request, argument);
      return errno == 0 ? 0 : -1;
    };
    return made;
  }

 private:
  int answer(unsigned long request, void* argument) {
    if (is_gone) return ENODEV;
    if (auto planned = errors.find(request); planned != errors.end() && !planned->second.empty()) {
      const int error = planned->second.front();
      planned->second.pop_front();
      if (error != 0) return error;
    }
    switch (request) {
      case VIDIOC_QUERYCAP: {
        auto& about = *static_cast<v4l2_capability*>(argument);
        std::strcpy(reinterpret_cast<char*>(about.driver), "fake");
        about.capabilities = V4L2_CAP_DEVICE_CAPS | V4L2_CAP_VIDEO_CAPTURE;
        about.device_caps = capabilities;
        return 0;
      }
      case VIDIOC_ENUM_FMT: {
        auto& one = *static_cast<v4l2_fmtdesc*>(argument);
        std::vector<uint32_t> each;
        for (const FakeMode& mode : modes) {
          if (std::find(each.begin(), each.end(), mode.fourcc) == each.end()) each.push_back(mode.fourcc);
        }
        if (one.index >= each.size()) return EINVAL;
        one.pixelformat = each[one.index];
        return 0;
      }
      case VIDIOC_ENUM_FRAMESIZES: {
        auto& one = *static_cast<v4l2_frmsizeenum*>(argument);
        const FakeMode* mode = nth(one.index, [&](const FakeMode& m) { return m.fourcc == one.pixel_format; });
        if (mode == nullptr) return EINVAL;
        one.type = V4L2_FRMSIZE_TYPE_DISCRETE;
        one.discrete = {mode->width, mode->height};
        return 0;
      }
      case VIDIOC_ENUM_FRAMEINTERVALS: {
        auto& one = *static_cast<v4l2_frmivalenum*>(argument);
        const FakeMode* mode = nth(one.index, [&](const FakeMode& m) {
          return m.fourcc == one.pixel_format && m.width == one.width && m.height == one.height;
        });
        if (mode == nullptr || mode->rate_hz == 0) return EINVAL;
        one.type = V4L2_FRMIVAL_TYPE_DISCRETE;
        one.discrete = {1, mode->rate_hz};
        return 0;
      }
      case VIDIOC_S_FMT: {
        auto& picture = static_cast<v4l2_format*>(argument)->fmt.pix;
        if (given_width != 0) picture.width = given_width;
        picture.field = field;
        picture.colorspace = V4L2_COLORSPACE_SRGB;
        return 0;
      }
      case VIDIOC_S_PARM: {
        auto& each = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
        if (each.denominator < least_rate_hz * each.numerator) each = {1, least_rate_hz};
        return 0;
      }
      case VIDIOC_REQBUFS:
        if (auto& wanted = *static_cast<v4l2_requestbuffers*>(argument); wanted.count > 0) {
          memory_.assign(wanted.count, std::vector<uint8_t>(kBytes));
        }
        return 0;
      case VIDIOC_QUERYBUF: {
        auto& one = *static_cast<v4l2_buffer*>(argument);
        one.length = kBytes;
        one.m.offset = one.index;
        return 0;
      }
      case VIDIOC_QBUF:
        queued_.push_back(static_cast<v4l2_buffer*>(argument)->index);
        return 0;
      case VIDIOC_DQBUF:
        return dequeue(*static_cast<v4l2_buffer*>(argument));
      case VIDIOC_STREAMON:
        ++n_starts;
        return 0;
      case VIDIOC_STREAMOFF:
        queued_.clear();
        return 0;
      case VIDIOC_DQEVENT: {
        auto& event = *static_cast<v4l2_event*>(argument);
        event.type = V4L2_EVENT_SOURCE_CHANGE;
        event.u.src_change.changes = V4L2_EVENT_SRC_CH_RESOLUTION;
        return 0;
      }
      case VIDIOC_QUERYCTRL: {
        auto& one = *static_cast<v4l2_queryctrl*>(argument);
        const auto at = controls.find(one.id);
        if (at == controls.end()) return EINVAL;
        one.minimum = at->second.minimum;
        one.maximum = at->second.maximum;
        one.default_value = at->second.otherwise;
        return 0;
      }
      case VIDIOC_G_CTRL: {
        auto& one = *static_cast<v4l2_control*>(argument);
        const auto at = controls.find(one.id);
        if (at == controls.end()) return EINVAL;
        one.value = at->second.now;
        return 0;
      }
      case VIDIOC_S_CTRL: {
        const auto& one = *static_cast<v4l2_control*>(argument);
        const auto at = controls.find(one.id);
        if (at == controls.end()) return EINVAL;
        at->second.now = one.value;
        return 0;
      }
      default:
        return ENOTTY;
    }
  }

  int dequeue(v4l2_buffer& out) {
    if (!is_due_ || frames.empty()) return EAGAIN;
    is_due_ = !frames.empty() && is_burst;
    const FakeFrame frame = frames.front();
    if (frame.error != 0) {
      frames.pop_front();
      return frame.error;
    }
    if (queued_.empty()) return EAGAIN;  // all buffers are out: a camera that leaks them stops here
    frames.pop_front();
    out.index = queued_.front();
    queued_.pop_front();
    std::copy(frame.bytes.begin(), frame.bytes.end(), memory_[out.index].begin());
    out.bytesused = static_cast<uint32_t>(frame.bytes.size());
    out.sequence = frame.sequence;
    out.flags = frame.flags;
    out.timestamp = {static_cast<time_t>(frame.stamp_us / 1'000'000),
                     static_cast<suseconds_t>(frame.stamp_us % 1'000'000)};
    return 0;
  }

  template <typename Fits>
  const FakeMode* nth(uint32_t n, Fits fits) {
    for (const FakeMode& mode : modes) {
      if (fits(mode) && n-- == 0) return &mode;
    }
    return nullptr;
  }

 public:
  bool is_burst = false;  // all frames are there at once

 private:
  static constexpr uint32_t kBytes = 4'096;
  std::vector<std::vector<uint8_t>> memory_;
  std::deque<uint32_t> queued_;
  bool is_due_ = false;
};

}  // namespace ruffini::test
