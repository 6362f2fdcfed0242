#include "capture/jpeg.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <vector>
// jpeglib.h requires size_t and FILE from the headers above.
#include <jpeglib.h>

namespace ruffini {
namespace {

constexpr int kWidth = 48;
constexpr int kHeight = 32;

// Smooth colours with some structure, as a pad's picture.
cv::Mat picture() {
  cv::Mat made(kHeight, kWidth, CV_8UC3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool is_dot = (x / 6 + y / 6) % 3 == 0;
      made.at<cv::Vec3b>(y, x) = cv::Vec3b(static_cast<uint8_t>(5 * x), static_cast<uint8_t>(7 * y), is_dot ? 40 : 200);
    }
  }
  return made;
}

std::vector<uint8_t> encoded(const cv::Mat& image, const std::vector<int>& how = {}) {
  std::vector<uint8_t> bytes;
  cv::imencode(".jpg", image, bytes, how);
  return bytes;
}

bool decodes(JpegDecoder& decoder, const std::vector<uint8_t>& bytes, cv::Mat& out) {
  out.create(kHeight, kWidth, CV_8UC3);
  return decoder.decode(bytes.data(), bytes.size(), kWidth, kHeight, out.data);
}

TEST(Jpeg, IsAsOpenCvDecodes) {
  JpegDecoder decoder;
  cv::Mat ours;
  for (const std::vector<int>& how :
       {std::vector<int>{}, {cv::IMWRITE_JPEG_QUALITY, 60}, {cv::IMWRITE_JPEG_RST_INTERVAL, 2}}) {
    const std::vector<uint8_t> bytes = encoded(picture(), how);
    ASSERT_TRUE(decodes(decoder, bytes, ours));
    EXPECT_EQ(cv::norm(ours, cv::imdecode(bytes, cv::IMREAD_COLOR), cv::NORM_INF), 0);
  }
  cv::Mat grey;
  cv::extractChannel(picture(), grey, 2);
  ASSERT_TRUE(decodes(decoder, encoded(grey), ours));
  EXPECT_EQ(cv::norm(ours, cv::imdecode(encoded(grey), cv::IMREAD_COLOR), cv::NORM_INF), 0);
}

TEST(Jpeg, BytesAfterAWholePictureAreFilling) {
  JpegDecoder decoder;
  cv::Mat ours;
  std::vector<uint8_t> bytes = encoded(picture());
  const std::vector<uint8_t> end(bytes.end() - 2, bytes.end());
  std::vector<uint8_t> inside = bytes;
  inside.insert(inside.end() - 2, 5, uint8_t{0});
  EXPECT_TRUE(decodes(decoder, inside, ours)) << "before its end marker";
  bytes.insert(bytes.end(), 100, uint8_t{0});
  EXPECT_TRUE(decodes(decoder, bytes, ours)) << "after it";
}

TEST(Jpeg, EachTruncationIsNoFrame) {
  JpegDecoder decoder;
  cv::Mat ours;
  const std::vector<uint8_t> bytes = encoded(picture());
  for (size_t n = 0; n + 2 < bytes.size(); ++n) {
    EXPECT_FALSE(decodes(decoder, {bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(n)}, ours)) << n;
  }
  EXPECT_TRUE(decodes(decoder, bytes, ours)) << "and the decoder goes on";
}

TEST(Jpeg, DamageNeverCrashesAndTheNextFrameIsWhole) {
  JpegDecoder decoder;
  cv::Mat ours;
  const std::vector<uint8_t> bytes = encoded(picture());
  const cv::Mat theirs = cv::imdecode(bytes, cv::IMREAD_COLOR);
  std::mt19937 random(5);
  for (int i = 0; i < 2'000; ++i) {
    std::vector<uint8_t> damaged = bytes;
    for (int k = 0; k < 1 + i % 8; ++k) damaged[random() % damaged.size()] = static_cast<uint8_t>(random());
    [[maybe_unused]] const bool is_whole = decodes(decoder, damaged, ours);
  }
  ASSERT_TRUE(decodes(decoder, bytes, ours));
  EXPECT_EQ(cv::norm(ours, theirs, cv::NORM_INF), 0);
}

// A JPEG file without its segments of the kind `marker`.
std::vector<uint8_t> without_segments(std::vector<uint8_t> bytes, uint8_t marker) {
  for (size_t i = 0; i + 3 < bytes.size();) {
    if (bytes[i] != 0xff || bytes[i + 1] != marker) {
      ++i;
      continue;
    }
    const size_t size = 2 + (size_t{bytes[i + 2]} << 8 | bytes[i + 3]);
    bytes.erase(bytes.begin() + static_cast<ptrdiff_t>(i), bytes.begin() + static_cast<ptrdiff_t>(i + size));
  }
  return bytes;
}

constexpr uint8_t kHuffmanTables = 0xc4;
constexpr uint8_t kQuantizationTables = 0xdb;

TEST(Jpeg, AFrameIsDecodedWithNoTablesOfTheFrameBefore) {
  const std::vector<uint8_t> fine = encoded(picture(), {cv::IMWRITE_JPEG_QUALITY, 95, cv::IMWRITE_JPEG_OPTIMIZE, 1});
  JpegDecoder decoder;
  cv::Mat ours;

  // Many USB cameras leave out the Huffman tables: the standard's are meant.
  const std::vector<uint8_t> bare = without_segments(encoded(picture()), kHuffmanTables);
  ASSERT_TRUE(decodes(decoder, fine, ours));
  ASSERT_TRUE(decodes(decoder, bare, ours));
  EXPECT_EQ(cv::norm(ours, cv::imdecode(encoded(picture()), cv::IMREAD_COLOR), cv::NORM_INF), 0);

  const std::vector<uint8_t> without = without_segments(encoded(picture()), kQuantizationTables);
  ASSERT_TRUE(decodes(decoder, fine, ours));
  EXPECT_FALSE(decodes(decoder, without, ours)) << "there are no standard quantization tables";
}

// A progressive file with a scan for each of the 64 coefficients of each component.
std::vector<uint8_t> with_a_scan_for_each_coefficient(const cv::Mat& image) {
  constexpr int kCoefficients = 64;
  jpeg_compress_struct out{};
  jpeg_error_mgr errors{};
  out.err = jpeg_std_error(&errors);
  jpeg_create_compress(&out);
  unsigned char* data = nullptr;
  unsigned long n_bytes = 0;
  jpeg_mem_dest(&out, &data, &n_bytes);
  out.image_width = static_cast<JDIMENSION>(image.cols);
  out.image_height = static_cast<JDIMENSION>(image.rows);
  out.input_components = image.channels();
  out.in_color_space = image.channels() == 1 ? JCS_GRAYSCALE : JCS_EXT_BGR;
  jpeg_set_defaults(&out);
  std::vector<jpeg_scan_info> scans;
  for (int component = 0; component < image.channels(); ++component) {
    for (int k = 0; k < kCoefficients; ++k) scans.push_back({1, {component, 0, 0, 0}, k, k, 0, 0});
  }
  out.scan_info = scans.data();
  out.num_scans = static_cast<int>(scans.size());
  jpeg_start_compress(&out, TRUE);
  for (int y = 0; y < image.rows; ++y) {
    auto* row = const_cast<JSAMPLE*>(image.ptr(y));
    jpeg_write_scanlines(&out, &row, 1);
  }
  jpeg_finish_compress(&out);
  jpeg_destroy_compress(&out);
  const std::vector<uint8_t> bytes(data, data + n_bytes);
  std::free(data);
  return bytes;
}

TEST(Jpeg, AFileMayHaveSeveralScansButNotHundreds) {
  JpegDecoder decoder(JpegDecoder::Scans::kAny);
  cv::Mat ours, grey;
  const std::vector<uint8_t> usual = encoded(picture(), {cv::IMWRITE_JPEG_PROGRESSIVE, 1});
  ASSERT_TRUE(decodes(decoder, usual, ours));
  EXPECT_EQ(cv::norm(ours, cv::imdecode(usual, cv::IMREAD_COLOR), cv::NORM_INF), 0);
  cv::extractChannel(picture(), grey, 2);
  EXPECT_TRUE(decodes(decoder, with_a_scan_for_each_coefficient(grey), ours)) << "64 scans";
  const std::vector<uint8_t> many = with_a_scan_for_each_coefficient(picture());
  EXPECT_FALSE(cv::imdecode(many, cv::IMREAD_COLOR).empty());
  EXPECT_FALSE(decodes(decoder, many, ours)) << "192 scans";
}

TEST(Jpeg, OtherSizesAndProgressiveOnesAreRefused) {
  JpegDecoder decoder;
  cv::Mat ours;
  EXPECT_FALSE(decodes(decoder, encoded(cv::Mat(kHeight, 2 * kWidth, CV_8UC3, cv::Scalar::all(9))), ours));
  EXPECT_FALSE(decodes(decoder, encoded(cv::Mat(kWidth, kHeight, CV_8UC3, cv::Scalar::all(9))), ours));
  EXPECT_FALSE(decodes(decoder, encoded(picture(), {cv::IMWRITE_JPEG_PROGRESSIVE, 1}), ours));
}

}  // namespace
}  // namespace ruffini
