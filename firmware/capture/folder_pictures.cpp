#include "capture/folder_pictures.h"

#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <exception>
#include <fstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "capture/jpeg.h"
#include "capture/png.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

constexpr std::array<std::string_view, 3> kOwnEndings{".png", ".jpg", ".jpeg"};
constexpr std::array<std::string_view, 2> kOtherEndings{".bmp", ".ppm"};
constexpr size_t kMaxPixels =
    size_t{1} << 24;  // larger than any sensor's picture; bounds what a broken header asks for
constexpr size_t kMaxFileBytes = size_t{1} << 27;

template <size_t n>
bool ends_with_one_of(const fs::path& path, const std::array<std::string_view, n>& endings) {
  return std::find(endings.begin(), endings.end(), path.extension().string()) != endings.end();
}

class FolderPictures : public Pictures {
 public:
  FolderPictures(std::vector<fs::path> files, PicturesOpener* open_other)
      : files_(std::move(files)), open_other_(open_other) {}

  std::optional<Picture> next() override {
    if (at_ == files_.size()) return std::nullopt;
    const fs::path& file = files_[at_++];
    try {  // a lack of memory
      std::error_code failed;
      if (!fs::is_regular_file(file, failed)) return Picture{};  // a pipe would be waited for
      return ends_with_one_of(file, kOtherEndings) ? decode_other(file) : decode(file);
    } catch (const std::exception&) {
      return Picture{};
    }
  }
  void rewind() override { at_ = 0; }
  [[nodiscard]] double rate_hz() const override { return 0; }

 private:
  // By what the file holds: its name may be wrong.
  Picture decode(const fs::path& file) {
    const uintmax_t n_bytes = fs::file_size(file);
    if (n_bytes == 0 || n_bytes > kMaxFileBytes) return {};
    bytes_.resize(static_cast<size_t>(n_bytes));
    std::ifstream stream(file, std::ios::binary);
    if (!stream.read(reinterpret_cast<char*>(bytes_.data()), static_cast<std::streamsize>(n_bytes))) return {};
    const PngSize size = bytes_[0] == 0xff ? decode_jpeg() : decode_png(bytes_, kMaxPixels, pixels_);
    if (size.width_px == 0) return {};
    return {size.width_px, size.height_px, pixels_.data(), ptrdiff_t{3} * size.width_px};
  }

  PngSize decode_jpeg() {
    const auto [width, height] = jpeg_.read_size(bytes_.data(), bytes_.size());
    const size_t n_pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
    if (n_pixels == 0 || n_pixels > kMaxPixels) return {};
    pixels_.resize(3 * n_pixels);
    if (!jpeg_.decode(bytes_.data(), bytes_.size(), width, height, pixels_.data())) return {};
    return {width, height};
  }

  Picture decode_other(const fs::path& file) {
    other_.reset(open_other_(file.c_str()));
    return other_ == nullptr ? Picture{} : other_->next().value_or(Picture{});
  }

  std::vector<fs::path> files_;
  PicturesOpener* open_other_;
  size_t at_ = 0;
  JpegDecoder jpeg_{JpegDecoder::Scans::kAny};
  std::vector<uint8_t> bytes_;
  std::vector<uint8_t> pixels_;
  std::unique_ptr<Pictures> other_;  // keeps the pixels
};

}  // namespace

PicturesOpener* load_picture_reader() {
  void* library = ::dlopen(kPicturesLibrary, RTLD_NOW | RTLD_LOCAL);  // stays to the end of the process
  return library == nullptr ? nullptr : reinterpret_cast<PicturesOpener*>(::dlsym(library, kPicturesOpener));
}

Error no_picture_reader() {
  return {ErrorKind::kUnavailable, std::string(kPicturesLibrary) +
                                       ": cannot be loaded: install it beside ruffinid, with OpenCV's imgcodecs and " +
                                       "videoio: it reads videos and images other than PNG and JPEG"};
}

Result<std::unique_ptr<Pictures>> open_folder(const fs::path& folder) {
  std::vector<fs::path> files;
  bool needs_reader = false;
  std::error_code failed;  // a folder that may not be read holds nothing
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, failed)) {
    const bool is_other = ends_with_one_of(entry.path(), kOtherEndings);
    if (is_other || ends_with_one_of(entry.path(), kOwnEndings)) files.push_back(entry.path());
    needs_reader |= is_other;
  }
  if (files.empty()) return std::unique_ptr<Pictures>();
  std::sort(files.begin(), files.end());
  PicturesOpener* open_other = needs_reader ? load_picture_reader() : nullptr;
  if (needs_reader && open_other == nullptr) return no_picture_reader();
  return std::unique_ptr<Pictures>(std::make_unique<FolderPictures>(std::move(files), open_other));
}

}  // namespace ruffini
