// The real library by OpenCV's dnn on networks of a few hundred bytes (tests/data/networks/make_networks.py).
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "infer/network.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

std::string file_of(const std::string& name) { return std::string(RUFFINI_TEST_DATA_DIR) + "/networks/" + name; }

const BoardSettings kBoard = test::round_board();

// One colour all over.
std::vector<uint8_t> picture(uint8_t b, uint8_t g, uint8_t r) {
  std::vector<uint8_t> out;
  for (int i = 0; i < kBoard.camera.width_px * kBoard.camera.height_px; ++i) out.insert(out.end(), {b, g, r});
  return out;
}

FrameView view(const std::vector<uint8_t>& pixels) {
  return {pixels.data(), kBoard.camera.width_px, kBoard.camera.height_px, 3, ptrdiff_t{3} * kBoard.camera.width_px};
}

TEST(DnnNetwork, SaysWhatTheFileComputes) {
  auto loaded = load_network(file_of("means.onnx"), kBoard);
  ASSERT_TRUE(loaded) << loaded.error().message;
  std::vector<float> out(2);
  const auto pixels = picture(10, 50, 30);
  ASSERT_TRUE(loaded.value().network->infer(view(pixels), out));
  EXPECT_NEAR(out[0], 10'000.0F, 0.1F);
  EXPECT_NEAR(out[1], 20.0F, 1e-3F);
  auto half = picture(0, 0, 0);  // the mean is over all of the picture
  std::copy_n(pixels.begin(), pixels.size() / 2, half.begin());
  ASSERT_TRUE(loaded.value().network->infer(view(half), out));
  EXPECT_NEAR(out[0], 5'000.0F, 0.1F);
}

TEST(DnnNetwork, NoNumberIsNoNumber) {
  auto loaded = load_network(file_of("nan.onnx"), kBoard);
  ASSERT_TRUE(loaded) << loaded.error().message;
  std::vector<float> out(2);
  ASSERT_TRUE(loaded.value().network->infer(view(picture(1, 2, 3)), out));
  EXPECT_TRUE(std::isnan(out[0]));
}

TEST(DnnNetwork, FewerOutputsAndAnotherSizeDoNotRun) {
  std::vector<float> out(2);
  for (const char* name : {"short.onnx", "small.onnx"}) {
    auto loaded = load_network(file_of(name), kBoard);
    ASSERT_TRUE(loaded) << loaded.error().message;
    EXPECT_FALSE(loaded.value().network->infer(view(picture(1, 2, 3)), out)) << name;
  }
}

TEST(DnnNetwork, AGraphThatOpenCvCannotReadIsAnError) {
  const std::string path = testing::TempDir() + "dnn_network" + std::to_string(::getpid());
  std::filesystem::copy_file(file_of("means.onnx"), path, std::filesystem::copy_options::overwrite_existing);
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  std::string bytes(std::filesystem::file_size(path), '\0');
  file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  const size_t at = bytes.find("GlobalAveragePool");
  ASSERT_NE(at, std::string::npos);
  file.seekp(static_cast<std::streamoff>(at));
  file << "Gl";
  file << "XXalAveragePool";
  file.close();
  const auto loaded = load_network(path, kBoard);
  std::filesystem::remove(path);
  ASSERT_FALSE(loaded);
  EXPECT_NE(loaded.error().message.find("OpenCV can run"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
