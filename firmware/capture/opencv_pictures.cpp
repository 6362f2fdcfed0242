// libruffini_pictures.so: images and videos by OpenCV.
#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "capture/pictures.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

constexpr std::array<std::string_view, 5> kEndings{".png", ".jpg", ".jpeg", ".bmp", ".ppm"};

Picture view_of(const cv::Mat& picture) {
  if (picture.empty() || picture.type() != CV_8UC3) return {};
  return {picture.cols, picture.rows, picture.ptr(), static_cast<ptrdiff_t>(picture.step)};
}

class FolderPictures : public Pictures {
 public:
  explicit FolderPictures(const fs::path& folder) {
    std::error_code failed;  // a folder that may not be read holds nothing
    for (const fs::directory_entry& entry : fs::directory_iterator(folder, failed)) {
      const std::string ending = entry.path().extension().string();
      if (std::find(kEndings.begin(), kEndings.end(), ending) != kEndings.end()) files_.push_back(entry.path());
    }
    std::sort(files_.begin(), files_.end());
  }
  [[nodiscard]] bool is_open() const { return !files_.empty(); }
  [[nodiscard]] double rate_hz() const override { return 0; }
  std::optional<Picture> next() override {
    if (at_ == files_.size()) return std::nullopt;
    const fs::path& file = files_[at_++];
    std::error_code failed;
    picture_.release();
    try {  // OpenCV throws on what it finds too large, on a lack of memory, and waits for a pipe
      if (fs::is_regular_file(file, failed)) picture_ = cv::imread(file.string(), cv::IMREAD_COLOR);
    } catch (const std::exception&) {
      picture_.release();
    }
    return view_of(picture_);
  }
  void rewind() override { at_ = 0; }

 private:
  std::vector<fs::path> files_;
  size_t at_ = 0;
  cv::Mat picture_;
};

class VideoPictures : public Pictures {
 public:
  explicit VideoPictures(std::string path) : path_(std::move(path)) {
    if (std::error_code failed; fs::is_regular_file(path_, failed)) video_.open(path_);
  }
  [[nodiscard]] bool is_open() const { return video_.isOpened(); }
  [[nodiscard]] double rate_hz() const override { return video_.get(cv::CAP_PROP_FPS); }
  std::optional<Picture> next() override {
    try {
      video_.read(picture_);
    } catch (const std::exception&) {
      return Picture{};
    }
    if (picture_.empty()) return std::nullopt;
    return view_of(picture_);
  }
  void rewind() override { video_.open(path_); }

 private:
  std::string path_;
  cv::VideoCapture video_;
  cv::Mat picture_;
};

template <typename T>
Pictures* if_open(std::unique_ptr<T> pictures) {
  return pictures->is_open() ? pictures.release() : nullptr;
}

}  // namespace
}  // namespace ruffini

extern "C" ruffini::Pictures* ruffini_open_pictures(const char* path) {
  // The libraries' own lines about a broken file would hide the daemon's.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ::setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
  std::error_code failed;
  if (ruffini::fs::is_directory(path, failed)) {
    return ruffini::if_open(std::make_unique<ruffini::FolderPictures>(path));
  }
  return ruffini::if_open(std::make_unique<ruffini::VideoPictures>(path));
}
