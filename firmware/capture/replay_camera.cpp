#include "capture/replay_camera.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <thread>

#include "board/plain_toml.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// Between two looks at the clock, which need not be the computer's own: a daemon that is to end waits no longer.
constexpr uint64_t kLookNs = 1'000'000;

const cv::Size kUnreadable(1, 1);  // stands for a file that is no picture: no board's size, so it is counted

constexpr int64_t kMinRateMhz = 100;  // as board.toml's
constexpr int64_t kMaxRateMhz = 1'000'000;

// A source of pictures; an empty Mat is the end.
class Pictures {
 public:
  virtual ~Pictures() = default;
  virtual cv::Mat next() = 0;
  virtual void rewind() = 0;
};

class FolderPictures : public Pictures {
 public:
  explicit FolderPictures(std::vector<fs::path> files) : files_(std::move(files)) {}
  cv::Mat next() override {
    if (at_ == files_.size()) return {};
    const fs::path& file = files_[at_++];
    std::error_code failed;
    cv::Mat picture;
    try {  // OpenCV throws on what it finds too large, on a lack of memory, and waits for a pipe
      if (fs::is_regular_file(file, failed)) picture = cv::imread(file.string(), cv::IMREAD_COLOR);
    } catch (const std::exception&) {
      picture.release();
    }
    return picture.empty() ? cv::Mat(kUnreadable, CV_8UC3) : picture;
  }
  void rewind() override { at_ = 0; }

 private:
  std::vector<fs::path> files_;
  size_t at_ = 0;
};

class VideoPictures : public Pictures {
 public:
  explicit VideoPictures(std::string path) : path_(std::move(path)) {
    if (std::error_code failed; fs::is_regular_file(path_, failed)) video_.open(path_);
  }
  [[nodiscard]] bool is_open() const { return video_.isOpened(); }
  [[nodiscard]] double rate_hz() const { return video_.get(cv::CAP_PROP_FPS); }
  cv::Mat next() override {
    cv::Mat picture;
    try {
      video_.read(picture);
    } catch (const std::exception&) {
      picture = cv::Mat(kUnreadable, CV_8UC3);
    }
    return picture;
  }
  void rewind() override { video_.open(path_); }

 private:
  std::string path_;
  cv::VideoCapture video_;
};

class ReplayCamera : public Camera {
 public:
  ReplayCamera(std::unique_ptr<Pictures> pictures, cv::Mat first, const ReplayOptions& options, int64_t rate_mhz,
               bool is_simulated, const Clock& clock)
      : pictures_(std::move(pictures)),
        pending_(std::move(first)),
        size_(pending_.size()),
        options_(options),
        period_ns_(static_cast<uint64_t>(1'000'000'000'000 / rate_mhz)),
        is_simulated_(is_simulated),
        clock_(clock) {}

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (pending_.empty()) pending_ = pictures_->next();
    if (pending_.empty() && options_.is_loop) {
      pictures_->rewind();
      pending_ = pictures_->next();
    }
    if (pending_.empty()) return CaptureStatus::kEnd;
    if (!options_.is_lockstep && !is_due()) return CaptureStatus::kNothing;
    const cv::Mat picture = std::exchange(pending_, cv::Mat());
    buffer.number = number_++;
    buffer.capture_us = clock_.now_us();
    if (picture.size() != size_ || picture.type() != CV_8UC3) return CaptureStatus::kInvalidFrame;
    for (int y = 0; y < picture.rows; ++y) {
      std::memcpy(buffer.pixels.data() + static_cast<size_t>(y) * static_cast<size_t>(picture.cols) * 3, picture.ptr(y),
                  static_cast<size_t>(picture.cols) * 3);
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
  cv::Mat pending_;
  cv::Size size_;
  ReplayOptions options_;
  uint64_t period_ns_;
  uint64_t due_ns_ = 0;
  uint64_t number_ = 0;
  bool is_simulated_;
  const Clock& clock_;
};

std::vector<fs::path> image_files(const fs::path& folder) {
  static const std::vector<std::string> kEndings = {".png", ".jpg", ".jpeg", ".bmp", ".ppm"};
  std::vector<fs::path> files;
  std::error_code failed;  // a folder that may not be read holds nothing
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, failed)) {
    const std::string ending = entry.path().extension().string();
    if (std::find(kEndings.begin(), kEndings.end(), ending) != kEndings.end()) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

struct RecordingInfo {
  bool is_simulated = false;
  int64_t rate_mhz = 0;
};

Result<RecordingInfo> read_info(const fs::path& folder, const BoardSettings& board) {
  RecordingInfo info;
  const fs::path path = folder / "recording.toml";
  if (!fs::is_regular_file(path)) return info;
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
  // The libraries' own lines about a broken file would hide ours.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ::setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
  std::error_code failed;
  const fs::path path(options.path);
  if (!fs::exists(path, failed)) {
    return Error{ErrorKind::kUnavailable, options.path + ": no such recording: check --camera replay:PATH"};
  }
  RecordingInfo info;
  std::unique_ptr<Pictures> pictures;
  double video_hz = 0;
  if (fs::is_directory(path, failed)) {
    auto read = read_info(path, board);
    if (!read) return read.error();
    info = read.value();
    const fs::path frames = fs::is_directory(path / "frames", failed) ? path / "frames" : path;
    std::vector<fs::path> files = image_files(frames);
    if (files.empty()) return Error{ErrorKind::kUnavailable, frames.string() + ": holds no PNG or JPEG images"};
    pictures = std::make_unique<FolderPictures>(std::move(files));
  } else {
    auto video = std::make_unique<VideoPictures>(options.path);
    if (!video->is_open()) {
      return Error{ErrorKind::kUnavailable, options.path + ": cannot be read as a video: is the file whole?"};
    }
    video_hz = video->rate_hz();
    pictures = std::move(video);
  }
  cv::Mat first = pictures->next();
  if (first.empty() || first.size() == kUnreadable) {
    return Error{ErrorKind::kUnavailable, options.path + ": its first frame cannot be read: is the file whole?"};
  }
  if (first.cols != board.camera.width_px || first.rows != board.camera.height_px) {
    return Error{ErrorKind::kBadInput, options.path + ": frames are " + std::to_string(first.cols) + "x" +
                                           std::to_string(first.rows) + ", board \"" + board.name + "\" needs " +
                                           std::to_string(board.camera.width_px) + "x" +
                                           std::to_string(board.camera.height_px)};
  }
  // Not every container says its rate; what it says may be nonsense, NaN included.
  const bool has_rate = video_hz * 1'000 >= kMinRateMhz && video_hz * 1'000 <= kMaxRateMhz;
  int64_t rate_mhz = has_rate ? static_cast<int64_t>(video_hz * 1'000) : board.camera.rate_mhz;
  if (info.rate_mhz > 0) rate_mhz = info.rate_mhz;
  return std::unique_ptr<Camera>(std::make_unique<ReplayCamera>(std::move(pictures), std::move(first), options,
                                                                rate_mhz, info.is_simulated, clock));
}

}  // namespace ruffini
