#include "capture/libcamera_camera.h"

#include <libcamera/libcamera.h>
#include <sys/sysmacros.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <future>
#include <mutex>
#include <optional>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#include "capture/libcamera_controls.h"
#include "capture/libcamera_metadata.h"
#include "capture/libcamera_session.h"
#include "capture/pixels.h"
#include "capture/stream_limits.h"
#include "capture/v4l2_exposure.h"
#include "hw/frame_memory.h"

namespace ruffini {
namespace {

namespace lc = libcamera;
using std::chrono::milliseconds;
using SteadyClock = std::chrono::steady_clock;

constexpr milliseconds kStopTime{2'000};

struct Format {
  lc::PixelFormat format;
  PixelLayout layout;
};
// In order of preference. libcamera names formats as DRM does, from the highest bits down, so RGB888 is B, G, R in
// memory.
const std::array<Format, 5>& formats() {
  static const std::array<Format, 5> kFormats = {{{lc::formats::RGB888, PixelLayout::kBgr},
                                                  {lc::formats::BGR888, PixelLayout::kRgb},
                                                  {lc::formats::XRGB8888, PixelLayout::kBgrx},
                                                  {lc::formats::YUYV, PixelLayout::kYuyv},
                                                  {lc::formats::NV12, PixelLayout::kNv12}}};
  return kFormats;
}

std::string number_of(int64_t device) {
  const auto number = static_cast<dev_t>(device);
  return std::to_string(major(number)) + ":" + std::to_string(minor(number));
}

class LibcameraCamera : public Camera {
 public:
  explicit LibcameraCamera(const BoardSettings& board)
      : board_(board), session_(std::make_unique<LibcameraSession>()) {}
  LibcameraCamera(LibcameraCamera&&) = delete;
  ~LibcameraCamera() override {
    if (session_ && session_->is_running) stop_in_time();
  }

  Status open(const std::string& name) {
    session_->manager = camera_manager();
    if (!session_->manager) return unavailable("libcamera", "did not start: does /dev/media* exist?");
    if (Status found = find(name); !found) return found;
    session_->camera->requestCompleted.connect(session_.get(), &LibcameraSession::complete);
    session_->camera->disconnected.connect(session_.get(), &LibcameraSession::disconnect);
    return start_in_some_format();
  }

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (!problem_.empty()) return CaptureStatus::kEnd;
    lc::Request* request = newest();
    if (request == nullptr) return without_frame();
    n_restarts_ = 0;
    last_frame_ = SteadyClock::now();
    const CaptureStatus status = take(*request, buffer);
    give_back(request);
    return status;
  }
  [[nodiscard]] std::string problem() const override { return problem_; }
  [[nodiscard]] bool is_simulated() const override { return is_simulated_; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  static Error unavailable(const std::string& what, const std::string& why) {
    return {ErrorKind::kUnavailable, "camera " + what + " " + why};
  }

  Status find(const std::string& name) {
    std::string ids;
    std::vector<std::shared_ptr<lc::Camera>> fitting;
    for (const auto& camera : session_->manager->cameras()) {
      ids += (ids.empty() ? "" : ", ") + camera->id();
      if (camera->id().find(name) != std::string::npos) fitting.push_back(camera);
    }
    // A pipeline whose links another program has configured may not list its camera.
    const std::string absent = "is not there, or another program uses it (fuser /dev/media*): libcamera sees ";
    if (ids.empty()) return unavailable(name, absent + "none. Look at its cable, then `cam -l`");
    if (fitting.empty()) return unavailable(name, absent + ids);
    if (fitting.size() > 1) {
      return Error{ErrorKind::kBadInput, "several cameras: choose one with --camera libcamera:NAME of " + ids};
    }
    session_->camera = fitting.front();
    id_ = session_->camera->id();
    // A pipeline that generates its pictures is no camera. vimc is the kernel's equivalent.
    is_simulated_ = id_.rfind("Virtual", 0) == 0 || id_.find("vimc") != std::string::npos;
    if (session_->camera->acquire() != 0) {
      return unavailable(id_, "is used by another program: end that one (fuser /dev/media*)");
    }
    session_->is_acquired = true;
    return Unit{};
  }

  // Selects the first of formats() that the camera supports and starts in: drivers accept formats in which they then do
  // not stream.
  Status start_in_some_format() {
    session_->configuration = session_->camera->generateConfiguration({lc::StreamRole::VideoRecording});
    if (!session_->configuration || session_->configuration->empty()) return unavailable(id_, "offers no video");
    const std::vector<lc::PixelFormat> offered = session_->configuration->at(0).formats().pixelformats();
    std::string seen;
    for (const lc::PixelFormat& format : offered) seen += " " + format.toString();
    bool was_configured = false;
    for (const Format& wanted : formats()) {
      if (std::find(offered.begin(), offered.end(), wanted.format) == offered.end()) continue;
      if (!configure(wanted, seen)) continue;
      was_configured = true;
      if (Status made = make_buffers(); !made) return made;
      if (Status asked = ask_controls(); !asked) return asked;
      if (start()) return Unit{};
      session_->free_buffers();
    }
    if (was_configured) return unavailable(id_, "did not start: is another program using it? dmesg says more");
    return Error{ErrorKind::kBadInput, "camera " + id_ + " has no mode of " + frame_size().toString() +
                                           " that board.toml asks for: it offers" + seen};
  }

  [[nodiscard]] lc::Size frame_size() const {
    return {static_cast<unsigned>(board_.camera.width_px), static_cast<unsigned>(board_.camera.height_px)};
  }

  // Appends what the camera would provide instead to `seen`.
  bool configure(const Format& wanted, std::string& seen) {
    lc::StreamConfiguration& stream = session_->configuration->at(0);
    stream.pixelFormat = wanted.format;
    stream.size = frame_size();
    stream.bufferCount = kRequests;
    if (session_->configuration->validate() == lc::CameraConfiguration::Invalid) return false;
    seen += "; " + stream.toString();
    if (stream.pixelFormat != wanted.format || stream.size != frame_size()) return false;
    layout_ = wanted.layout;
    rule_ = rule_of(stream.colorSpace);
    return session_->camera->configure(session_->configuration.get()) == 0;
  }

  [[nodiscard]] std::vector<lc::FrameBuffer::Plane> planes(const lc::SharedFD& fd) const {
    const lc::StreamConfiguration& stream = session_->configuration->at(0);
    if (layout_ != PixelLayout::kNv12) return {{fd, 0, stream.frameSize}};
    const unsigned luma = stream.stride * stream.size.height;
    return {{fd, 0, luma}, {fd, luma, luma / 2}};
  }

  // Memory from DMA heaps is cached, so reading is fast. A pipeline without heaps allocates its own, or accepts a
  // memfd.
  Status make_buffers() {
    lc::Stream* stream = session_->configuration->at(0).stream();
    std::vector<lc::FrameBuffer*> buffers;
    bool is_dma = true;
    for (unsigned i = 0; i < kRequests; ++i) {
      Result<FrameMemory> memory = allocate_frame_memory(session_->configuration->at(0).frameSize);
      if (!memory) return memory.error();
      is_dma = is_dma && memory.value().is_dma;
      const int number = memory.value().fd.get();
      const lc::SharedFD fd(number);  // duplicates the descriptor; from an rvalue it would take ownership
      session_->own_buffers.push_back(std::make_unique<lc::FrameBuffer>(planes(fd)));
      buffers.push_back(session_->own_buffers.back().get());
    }
    if (!is_dma) {
      session_->allocator = std::make_unique<lc::FrameBufferAllocator>(session_->camera);
      if (session_->allocator->allocate(stream) >= static_cast<int>(kRequests)) {
        session_->own_buffers.clear();
        buffers.clear();
        for (const auto& buffer : session_->allocator->buffers(stream)) buffers.push_back(buffer.get());
      }
    }
    for (lc::FrameBuffer* buffer : buffers) {
      size_t n_bytes = 0;
      for (const auto& plane : buffer->planes()) n_bytes = std::max<size_t>(n_bytes, plane.offset + plane.length);
      const auto at = session_->mappings.emplace(buffer, FrameMapping(buffer->planes()[0].fd.get(), n_bytes));
      session_->requests.push_back(session_->camera->createRequest());
      if (at.first->second.data() == nullptr || !session_->requests.back() ||
          session_->requests.back()->addBuffer(stream, buffer) != 0) {
        return unavailable(id_, "takes no frame memory: is memory free?");
      }
    }
    return Unit{};
  }

  Status ask_controls() {
    const int64_t period_us = 1'000'000'000 / board_.camera.rate_mhz;
    const std::array<int64_t, 2> limits = {period_us, period_us};
    // The virtual pipeline has the control, but still gives a thousand frames a second.
    is_paced_here_ = !add_control(*session_->camera, "FrameDurationLimits",
                                  lc::ControlValue(lc::Span<const int64_t, 2>(limits)), controls_) ||
                     is_simulated_;
    period_ = std::chrono::microseconds(period_us);
    if (board_.exposure.white_kelvin != 0 && !by_device_) {
      if (Status set = set_by_device(); !set) return set;
    }
    return add_exposure_controls(*session_->camera, board_.exposure, controls_);
  }

  // Controls that libcamera's USB pipeline does not support.
  Status set_by_device() {
    const auto nodes = session_->camera->properties().get(lc::properties::SystemDevices);
    if (!nodes || nodes->size() != 1) {
      return Error{ErrorKind::kBadInput, "camera " + id_ +
                                             " is none on USB: give red_1e3 and blue_1e3 in [exposure] of "
                                             "board.toml instead of white_kelvin"};
    }
    Result<V4l2Controls> made = V4l2Controls::open(id_, "/dev/char/" + number_of((*nodes)[0]), board_.exposure);
    if (!made) return made.error();
    by_device_ = std::move(made).value();
    return Unit{};
  }

  bool start() {
    n_settling_ = kSettlingFrames;
    has_sequence_ = false;
    last_frame_ = SteadyClock::now();
    if (session_->camera->start(&controls_) != 0) return false;
    session_->is_running = true;
    for (const auto& request : session_->requests) give_back(request.get());
    return true;
  }

  void give_back(lc::Request* request) {
    if (request->status() != lc::Request::RequestPending) request->reuse(lc::Request::ReuseBuffers);
    session_->camera->queueRequest(request);
  }

  // Waits for a frame; older waiting frames return to the camera.
  lc::Request* newest() {
    if (is_paced_here_) {
      std::this_thread::sleep_until(due_);
      due_ = std::max(due_ + period_, SteadyClock::now());
    }
    std::array<lc::Request*, kRequests> taken{};
    size_t n = 0;
    {
      std::unique_lock lock(session_->mutex);
      session_->changed.wait_for(lock, kFrameWait, [&] { return session_->n_done > 0 || session_->is_gone; });
      std::swap(taken, session_->done);
      std::swap(n, session_->n_done);
    }
    for (size_t i = 0; i + 1 < n; ++i) give_back(taken[i]);
    return n == 0 ? nullptr : taken[n - 1];
  }

  [[nodiscard]] bool is_told_gone() const {
    const std::lock_guard lock(session_->mutex);
    return session_->is_gone;
  }
  // The kernel may know before libcamera: the device nodes have disappeared.
  [[nodiscard]] bool is_gone() const {
    if (is_told_gone()) return true;
    const std::string numbers = "/sys/dev/char/";
    std::error_code error;
    const auto nodes = session_->camera->properties().get(lc::properties::SystemDevices);
    if (!nodes || !std::filesystem::exists(numbers, error)) return false;
    return std::any_of(nodes->begin(), nodes->end(), [&](int64_t node) {
      return !std::filesystem::exists(numbers + number_of(node), error) && !error;
    });
  }

  CaptureStatus without_frame() {
    if (is_told_gone()) return end("was unplugged");
    if (SteadyClock::now() - last_frame_ < longest_silence(period_, n_restarts_)) return CaptureStatus::kNothing;
    if (is_gone()) return end("was unplugged");
    if (++n_restarts_ > kMaxRestarts) return end("gives no frames, though it was started again: dmesg says more");
    if (!stop_in_time()) return end("does not stop: it is left to the kernel, which may need a reboot");
    {
      const std::lock_guard lock(session_->mutex);
      session_->n_done = 0;
    }
    for (const auto& request : session_->requests) request->reuse(lc::Request::ReuseBuffers);
    // An unplug may become visible only while the camera is started again.
    if (!start()) return end(is_gone() ? "was unplugged" : "gave no frames and did not start again: dmesg says more");
    return CaptureStatus::kNothing;
  }

  CaptureStatus end(const char* why) {
    problem_ = "camera " + id_ + " " + why;
    return CaptureStatus::kEnd;
  }

  // If stop() does not return, the session is abandoned, with everything that it may still access. So is a camera that
  // was unplugged: libcamera (0.7.1) aborts the process if a camera is stopped whose requests the kernel never
  // returned.
  bool stop_in_time() {
    if (is_gone()) {
      abandoned_ = session_.release();
      return false;
    }
    session_->is_running = false;
    std::promise<void> promise;
    const std::future<void> stopped = promise.get_future();
    std::thread([camera = session_->camera, p = std::move(promise)]() mutable {
      camera->stop();
      p.set_value();
    }).detach();
    if (stopped.wait_for(kStopTime) == std::future_status::ready) return true;
    abandoned_ = session_.release();
    return false;
  }

  CaptureStatus take(lc::Request& request, FramePool::Buffer& buffer) {
    lc::FrameBuffer* frame = request.buffers().begin()->second;
    const lc::FrameMetadata& about = frame->metadata();
    // Frames of a camera without a rate that arrive too early are not missing.
    const uint32_t step = has_sequence_ && !is_paced_here_ ? about.sequence - sequence_ : 1;
    has_sequence_ = true;
    sequence_ = about.sequence;
    number_ += step;
    buffer.number = number_;
    buffer.capture_us = middle_us(request.metadata(), about);
    if (n_settling_ > 0 && board_.exposure.is_manual()) {
      --n_settling_;
      return CaptureStatus::kNothing;
    }
    if (about.status != lc::FrameMetadata::FrameSuccess) return CaptureStatus::kInvalidFrame;
    std::string drift = drift_of(request.metadata(), board_.exposure);
    if (drift.empty() && by_device_) drift = by_device_->drift(SteadyClock::now());
    if (!drift.empty()) {
      if (++n_drifted_ >= kMaxDrifted) {
        problem_ = "camera " + id_ + " has " + drift + ": give [exposure] numbers that it can keep";
        return CaptureStatus::kEnd;
      }
      return CaptureStatus::kInvalidFrame;
    }
    n_drifted_ = 0;
    copy(*frame, buffer.pixels.data());
    return CaptureStatus::kFrame;
  }

  void copy(const lc::FrameBuffer& frame, uint8_t* out) const {
    const lc::StreamConfiguration& stream = session_->configuration->at(0);
    const FrameMapping& mapping = session_->mappings.at(&frame);
    RawFrame raw;
    for (size_t i = 0; i < std::min(frame.planes().size(), raw.planes.size()); ++i) {
      raw.planes[i] = mapping.data() + frame.planes()[i].offset;
      raw.strides[i] = static_cast<ptrdiff_t>(stream.stride);
    }
    mapping.begin_read();
    to_bgr(layout_, rule_, raw, board_.camera.width_px, board_.camera.height_px, out);
    mapping.end_read();
  }

  BoardSettings board_;
  std::unique_ptr<LibcameraSession> session_;
  LibcameraSession* abandoned_ = nullptr;  // never deleted: the kernel may still write there
  std::string id_;
  std::string problem_;
  bool is_simulated_ = false;
  PixelLayout layout_ = PixelLayout::kBgr;
  YuvRule rule_ = kFull601;
  std::optional<V4l2Controls> by_device_;
  lc::ControlList controls_{lc::controls::controls};
  bool is_paced_here_ = false;
  SteadyClock::duration period_{};
  SteadyClock::time_point due_{};
  SteadyClock::time_point last_frame_{};
  int n_settling_ = 0;
  int n_drifted_ = 0;
  int n_restarts_ = 0;
  bool has_sequence_ = false;
  uint32_t sequence_ = 0;
  uint64_t number_ = 0;
};

}  // namespace

Result<std::unique_ptr<Camera>> open_libcamera(const std::string& name, const BoardSettings& board) {
  auto camera = std::make_unique<LibcameraCamera>(board);
  if (Status opened = camera->open(name); !opened) return opened.error();
  return std::unique_ptr<Camera>(std::move(camera));
}

}  // namespace ruffini
