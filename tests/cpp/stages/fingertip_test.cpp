#include "stages/fingertip/fingertip.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>
#include <string>
#include <vector>

#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

constexpr int kPins = 7;
constexpr int kFeatures = 5;  // one place of three, and where it is
constexpr int kWide = 3;
constexpr int kOutputs = 14;
constexpr int32_t kOne = 1 << 14;
constexpr int32_t kWeight = 1 << 26;

// Tables of numbers as large as load() lets them be: nothing is likely, everything is allowed.
struct Hostile {
  int32_t sign = 1;
  int32_t length = 1 << 20;
  int32_t limit = 1 << 20;
  int32_t scale = 1 << 24;

  [[nodiscard]] std::vector<uint8_t> bytes() const {
    test::CalibrationBytes file;
    file.meta("kinds", "fingertip").meta("board", "any").meta("optics", "any").meta("resolution", "640x240");
    file.meta("sensor_serial", "*").meta("fingertip.most_un", "1000000");
    const auto put = [&](const std::string& name, const std::vector<int>& shape, int32_t value) {
      size_t n = 1;
      for (const int size : shape) n *= static_cast<size_t>(size);
      file.tensor("fingertip." + name, "I32", shape, std::vector<int32_t>(n, value));
    };
    std::vector<int32_t> rest, normal;
    for (int eye = 0; eye < 2; ++eye) {
      for (int i = 0; i < kPins; ++i) rest.insert(rest.end(), {(eye * 320 + 20 * i) << 8, 100 << 8});
    }
    for (int i = 0; i < kPins; ++i) normal.insert(normal.end(), {kOne / 3 * (i % 3 - 1), kOne / 4, kOne});
    file.tensor("fingertip.rest", "I32", {2, kPins, 2}, rest).tensor("fingertip.normal", "I32", {kPins, 3}, normal);
    put("gain", {3, kPins, 3, 4}, -(1 << 24));
    file.tensor("fingertip.place", "I32", {1, 3}, std::vector<int32_t>{0, 0, kOne});
    put("kernel", {2048}, 1 << 15);
    file.tensor("fingertip.gate", "I32", {2}, std::vector<int32_t>{512, 1});
    put("zero", {7}, sign << 24);
    put("scale", {7}, scale);
    put("trust", {3, 7}, std::numeric_limits<int32_t>::max());
    put("mean", {3, kFeatures}, -sign * kWeight);
    put("near", {3, kWide}, kWeight);
    put("length", {3, kWide}, length);
    put("limit", {3, 2}, limit);
    put("weight0", {3, kWide, kFeatures}, sign * kWeight);
    put("weight1", {3, kWide, kWide}, kWeight);
    put("weight2", {3, kWide, kWide}, kWeight);
    put("weight3", {3, kOutputs, kWide}, sign * kWeight);
    put("bias1", {3, kWide}, kWeight);
    put("bias2", {3, kWide}, kWeight);
    put("bias3", {3, kOutputs}, sign * kWeight);
    return file.bytes();
  }
};

std::vector<Marker> markers(int32_t moved) {
  std::vector<Marker> out(2 * kPins);
  for (int i = 0; i < 2 * kPins; ++i) {
    Marker& m = out[static_cast<size_t>(i)];
    m.rest_x = ImagePx::from_raw(((i / kPins) * 320 + 20 * (i % kPins)) << 16);
    m.rest_y = ImagePx::from_raw(100 << 16);
    m.displacement_x = m.displacement_y = ImagePx::from_raw(moved);
    m.is_lost = m.is_absent = false;
    m.quality = 255;
  }
  return out;
}

Result<Fingertip> loaded(const std::vector<uint8_t>& bytes) {
  const auto file = Calibration::parse(bytes);
  EXPECT_TRUE(file.has_value()) << (file ? "" : file.error().message);
  return Fingertip::load(file.value());
}

// Under the sanitizer of undefined behaviour this is the test that nothing overflows.
TEST(Fingertip, AHostileTableOverflowsNothing) {
  for (const int32_t sign : {1, -1}) {
    const std::vector<uint8_t> bytes = Hostile{.sign = sign}.bytes();
    auto tip = loaded(bytes);
    ASSERT_TRUE(tip.has_value()) << tip.error().message;
    tip.value().learn(markers(0));
    EXPECT_FALSE(tip.value().is_other_pad(Eyes::kBoth));
    for (const Eyes eyes : {Eyes::kBoth, Eyes::kLeft, Eyes::kRight}) {
      SaturationCounter saturations;
      const TipTouch touch = tip.value().run(markers(std::numeric_limits<int32_t>::max()), eyes, saturations);
      ASSERT_TRUE(touch.is_touched);
      EXPECT_GT(saturations.count, 0);
      EXPECT_LE(touch.force_un, int64_t{1} << 30);
      EXPECT_LE(touch.area_um2, int64_t{1} << 60);
      for (const int64_t place : {touch.x_um, touch.y_um}) EXPECT_LE(std::abs(place), int64_t{1} << 35);
      for (const int64_t angle : {touch.roll_urad, touch.pitch_urad}) EXPECT_LE(std::abs(angle), 3'141'593);
      for (const int64_t sigma : touch.sigma) EXPECT_GT(sigma, 0);
    }
  }
}

TEST(Fingertip, NumbersThatWouldOverflowAreRefused) {
  for (const Hostile& each : {Hostile{.length = (1 << 20) + 1}, Hostile{.limit = (1 << 20) + 1},
                              Hostile{.length = -(1 << 20) - 1}, Hostile{.scale = (1 << 24) + 1}}) {
    const std::vector<uint8_t> bytes = each.bytes();
    const auto tip = loaded(bytes);
    ASSERT_FALSE(tip.has_value());
    EXPECT_EQ(tip.error().kind, ErrorKind::kBadInput);
    EXPECT_NE(tip.error().message.find("fingertip."), std::string::npos);
  }
}

}  // namespace
}  // namespace ruffini
