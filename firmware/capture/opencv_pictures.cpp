// libruffini_pictures.so: videos, and images that are neither PNG nor JPEG, by OpenCV.
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

#include "capture/pictures.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

constexpr std::array<std::string_view, 2> kImageEndings{".bmp", ".ppm"};

Picture view_of(const cv::Mat& picture) {
  if (picture.empty() || picture.type() != CV_8UC3) return {};
  return {picture.cols, picture.rows, picture.ptr(), static_cast<ptrdiff_t>(picture.step)};
}

class ImagePictures : public Pictures {
 public:
  explicit ImagePictures(std::string path) : path_(std::move(path)) {}
  [[nodiscard]] double rate_hz() const override { return 0; }
  std::optional<Picture> next() override {
    if (was_read_) return std::nullopt;
    was_read_ = true;
    picture_.release();
    try {  // OpenCV throws on what it finds too large and on a lack of memory
      picture_ = cv::imread(path_, cv::IMREAD_COLOR);
    } catch (const std::exception&) {
      picture_.release();
    }
    return view_of(picture_);
  }
  void rewind() override { was_read_ = false; }

 private:
  std::string path_;
  bool was_read_ = false;
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

}  // namespace
}  // namespace ruffini

extern "C" ruffini::Pictures* ruffini_open_pictures(const char* path) {
  // The libraries' own lines about a broken file would hide the daemon's.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ::setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
  const std::string ending = ruffini::fs::path(path).extension().string();
  const auto& images = ruffini::kImageEndings;
  if (std::find(images.begin(), images.end(), ending) != images.end()) return new ruffini::ImagePictures(path);
  auto video = std::make_unique<ruffini::VideoPictures>(path);
  return video->is_open() ? video.release() : nullptr;
}
