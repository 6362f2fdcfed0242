#include "capture/replay_camera.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>
#include <utility>

#include "board/plain_toml.h"
#include "capture/folder_pictures.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// Between two looks at the clock, which need not be the computer's own: a daemon that is to end waits no longer.
constexpr uint64_t kLookNs = 1'000'000;

constexpr int64_t kMinRateMhz = 100;  // as board.toml's
constexpr int64_t kMaxRateMhz = 1'000'000;

class ReplayCamera : public Camera {
 public:
  ReplayCamera(std::unique_ptr<Pictures> pictures, const Picture& first, const ReplayOptions& options, int64_t rate_mhz,
               bool is_simulated, const Clock& clock)
      : pictures_(std::move(pictures)),
        pending_(first),
        width_px_(first.width_px),
        height_px_(first.height_px),
        options_(options),
        period_ns_(static_cast<uint64_t>(1'000'000'000'000 / rate_mhz)),
        is_simulated_(is_simulated),
        clock_(clock) {}

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (!pending_) pending_ = pictures_->next();
    if (!pending_ && options_.is_loop) {
      pictures_->rewind();
      pending_ = pictures_->next();
    }
    if (!pending_) return CaptureStatus::kEnd;
    if (!options_.is_lockstep && !is_due()) return CaptureStatus::kNothing;
    const Picture picture = *std::exchange(pending_, std::nullopt);
    buffer.number = number_++;
    buffer.capture_us = clock_.now_us();
    if (picture.width_px != width_px_ || picture.height_px != height_px_) return CaptureStatus::kInvalidFrame;
    const size_t n_bytes = static_cast<size_t>(width_px_) * 3;
    for (int y = 0; y < height_px_; ++y) {
      std::memcpy(buffer.pixels.data() + static_cast<size_t>(y) * n_bytes, picture.pixels + y * picture.row_bytes,
                  n_bytes);
    }
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return is_simulated_; }
  [[nodiscard]] bool is_replay() const override { return true; }

 private:
  // Waits for the next frame's time, kLookNs at most.
  bool is_due() {
    uint64_t now_ns = 1'000 * clock_.now_us();
    if (due_ns_ == 0) due_ns_ = now_ns;
    if (now_ns < due_ns_) {
      std::this_thread::sleep_for(std::chrono::nanoseconds(std::min(due_ns_ - now_ns, kLookNs)));
      now_ns = 1'000 * clock_.now_us();
    }
    if (now_ns < due_ns_) return false;
    if (due_ns_ + period_ns_ < now_ns) due_ns_ = now_ns;  // the reader fell behind: do not catch up in a burst
    due_ns_ += period_ns_;
    return true;
  }

  std::unique_ptr<Pictures> pictures_;
  std::optional<Picture> pending_;
  int width_px_;
  int height_px_;
  ReplayOptions options_;
  uint64_t period_ns_;
  uint64_t due_ns_ = 0;
  uint64_t number_ = 0;
  bool is_simulated_;
  const Clock& clock_;
};

// Errors: kUnavailable, if libruffini_pictures.so is needed and cannot be loaded. nullptr: there is no picture.
Result<std::unique_ptr<Pictures>> open_pictures(const fs::path& path) {
  std::error_code failed;
  if (fs::is_directory(path, failed)) return open_folder(path);
  PicturesOpener* opener = load_picture_reader();
  if (opener == nullptr) return no_picture_reader();
  return std::unique_ptr<Pictures>(opener(path.c_str()));
}

struct RecordingInfo {
  bool is_simulated = false;
  int64_t rate_mhz = 0;
};

Result<RecordingInfo> read_info(const fs::path& folder, const BoardSettings& board) {
  RecordingInfo info;
  const fs::path path = folder / "recording.toml";
  std::error_code failed;
  const fs::file_type type = fs::status(path, failed).type();  // fails for a link that leads in a circle
  if (type == fs::file_type::not_found) return info;
  if (type != fs::file_type::regular) {
    return Error{ErrorKind::kUnavailable, path.string() + ": is not a file that can be read: remove or replace it"};
  }
  std::ifstream stream(path, std::ios::binary);
  if (!stream) return Error{ErrorKind::kUnavailable, path.string() + ": cannot be read: check its permissions"};
  const std::string text(std::istreambuf_iterator<char>(stream), {});
  const Result<toml::table> parsed = parse_plain_toml(text, path.string());
  if (!parsed) return parsed.error();
  const toml::table& table = parsed.value();
  const auto refuse = [&path](const char* what) {
    return Error{ErrorKind::kBadInput, path.string() + ": " + what + " (boards/README.md lists the keys)"};
  };
  // A mark that cannot be read must not turn simulated frames into measured ones.
  if (const toml::node* simulated = table.get("simulated")) {
    if (!simulated->is_boolean()) return refuse("simulated must be true or false");
    info.is_simulated = simulated->as_boolean()->get();
  }
  if (const toml::node* rate = table.get("rate_mhz")) {
    info.rate_mhz = rate->is_integer() ? rate->as_integer()->get() : 0;
    if (info.rate_mhz < kMinRateMhz || info.rate_mhz > kMaxRateMhz) {
      return refuse("rate_mhz must be an integer from 100 to 1000000");
    }
  }
  if (const toml::node* recorded = table.get("board")) {
    if (!recorded->is_string()) return refuse("board must be a text");
    const std::string& name = recorded->as_string()->get();
    if (name != board.name) {
      return Error{ErrorKind::kBadInput, path.string() + ": recorded with board \"" + name + "\", this is \"" +
                                             board.name + "\": choose the board that fits"};
    }
  }
  return info;
}

}  // namespace

Result<std::unique_ptr<Camera>> open_replay(const ReplayOptions& options, const BoardSettings& board,
                                            const Clock& clock) {
  std::error_code failed;
  const fs::path path(options.path);
  if (!fs::exists(path, failed)) {
    return Error{ErrorKind::kUnavailable, options.path + ": no such recording: check --camera replay:PATH"};
  }
  RecordingInfo info;
  fs::path source = path;
  const bool is_folder = fs::is_directory(path, failed);
  if (is_folder) {
    auto read = read_info(path, board);
    if (!read) return read.error();
    info = read.value();
    if (fs::is_directory(path / "frames", failed)) source = path / "frames";
  }
  auto opened = open_pictures(source);
  if (!opened) return opened.error();
  std::unique_ptr<Pictures> pictures = std::move(opened).value();
  if (pictures == nullptr) {
    return Error{ErrorKind::kUnavailable, is_folder ? source.string() + ": holds no PNG or JPEG images"
                                                    : options.path + ": cannot be read as a video: is the file whole?"};
  }
  const double video_hz = pictures->rate_hz();
  const std::optional<Picture> first = pictures->next();
  if (!first || first->pixels == nullptr) {
    return Error{ErrorKind::kUnavailable, options.path + ": its first frame cannot be read: is the file whole?"};
  }
  if (first->width_px != board.camera.width_px || first->height_px != board.camera.height_px) {
    return Error{ErrorKind::kBadInput, options.path + ": frames are " + std::to_string(first->width_px) + "x" +
                                           std::to_string(first->height_px) + ", board \"" + board.name + "\" needs " +
                                           std::to_string(board.camera.width_px) + "x" +
                                           std::to_string(board.camera.height_px)};
  }
  // Not every container says its rate; what it says may be nonsense, NaN included.
  const bool has_rate = video_hz * 1'000 >= kMinRateMhz && video_hz * 1'000 <= kMaxRateMhz;
  int64_t rate_mhz = has_rate ? static_cast<int64_t>(video_hz * 1'000) : board.camera.rate_mhz;
  if (info.rate_mhz > 0) rate_mhz = info.rate_mhz;
  return std::unique_ptr<Camera>(
      std::make_unique<ReplayCamera>(std::move(pictures), *first, options, rate_mhz, info.is_simulated, clock));
}

}  // namespace ruffini
