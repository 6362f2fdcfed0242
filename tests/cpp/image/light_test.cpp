#include "image/light.h"

#include <gtest/gtest.h>

namespace ruffini {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr size_t kPixels = size_t{kWidth} * kHeight;

// A pad of one grey, and frames of it under other light.
struct Pad {
  Pad() {
    rest.load(std::vector<uint16_t>(3 * kPixels, 16 * 100));
    light.learn(rest.image(), true);
  }
  // One frame with B, G, R times `gain` (1/4096), its left `n_touched` columns darker by 20 %.
  void show(std::array<int, 3> gain, int n_touched = 0, std::span<const Marker> markers = {}) {
    std::vector<RelativeChange> change(3 * kPixels);
    for (size_t i = 0; i < change.size(); ++i) {
      const bool is_touched = static_cast<int>(i % kWidth) < n_touched;
      const int seen = gain[i / kPixels] * (is_touched ? 4 : 5) / 5;
      const int64_t now8 = int64_t{12'800} * seen / 4096;  // 100 levels
      change[i] = RelativeChange::from_raw(
          static_cast<int16_t>(((now8 - rest.planes8()[i]) * rest.reciprocal()[i] + (1 << 14)) >> 15));
    }
    light.run(change, markers, rest);
  }
  [[nodiscard]] double gain(size_t channel) const { return light.gain()[channel] / double{Rest::kUnitGain}; }

  Rest rest{kWidth, kHeight, 1};
  LightTracker light{kWidth, kHeight};
};

Marker moved_by(double px) {
  Marker marker;
  marker.displacement_x = ImagePx::from_raw(static_cast<int32_t>(px * 65'536));
  marker.is_lost = marker.is_absent = false;
  return marker;
}

constexpr std::array<int, 3> kBluer = {4096 * 110 / 100, 4096, 4096 * 95 / 100};

TEST(LightTracker, FollowsEachChannelOfAnUntouchedPadAndThenTheChangeIsZero) {
  Pad pad;
  for (int i = 0; i < 16; ++i) pad.show(kBluer);
  EXPECT_TRUE(pad.light.is_wrong());
  EXPECT_NEAR(pad.gain(0), 1.0005, 1e-4);  // it waits for 16 still frames, then takes 1/2048 a frame
  for (int i = 0; i < 400; ++i) pad.show(kBluer);
  EXPECT_FALSE(pad.light.is_wrong());
  EXPECT_NEAR(pad.gain(0), 1.10, 0.001);
  EXPECT_NEAR(pad.gain(1), 1.00, 0.001);
  EXPECT_NEAR(pad.gain(2), 0.95, 0.001);
  EXPECT_NEAR(pad.rest.planes8()[0], 14'080, 14);
  EXPECT_NEAR(pad.rest.reciprocal()[0], 9'533, 10);
}

TEST(LightTracker, AHeldContactIsNeverLearned) {
  Pad pad;
  for (int i = 0; i < 20'000; ++i) pad.show({4096, 4096, 4096}, kWidth / 4);
  EXPECT_EQ(pad.light.gain(), Rest::unit_gain());
  EXPECT_FALSE(pad.light.is_wrong());
  // One that shades everything alike, by its markers.
  const std::vector<Marker> markers = {moved_by(0.1), moved_by(-0.3)};
  for (int i = 0; i < 20'000; ++i) pad.show({4000, 4000, 4000}, 0, markers);
  EXPECT_EQ(pad.light.gain(), Rest::unit_gain());
}

TEST(LightTracker, MarkersAtRestOrLostDoNotStopIt) {
  Pad pad;
  std::vector<Marker> markers = {moved_by(0.2), moved_by(3)};
  markers[1].is_lost = true;
  for (int i = 0; i < 400; ++i) pad.show(kBluer, 0, markers);
  EXPECT_NEAR(pad.gain(0), 1.10, 0.001);
}

// Of a lamp, say: with markers at rest it is no contact.
TEST(LightTracker, AnUnevenPictureWithMarkersAtRestIsSaidAtOnce) {
  Pad pad;
  std::vector<Marker> markers = {moved_by(0.1), moved_by(-0.2)};
  pad.show({4096, 4096, 4096}, kWidth / 2, markers);
  EXPECT_TRUE(pad.light.is_wrong());
  markers[1] = moved_by(0.3);
  pad.show({4096, 4096, 4096}, kWidth / 2, markers);
  EXPECT_FALSE(pad.light.is_wrong());
  for (Marker& marker : markers) marker.is_lost = true;
  pad.show({4096, 4096, 4096}, kWidth / 2, markers);
  EXPECT_FALSE(pad.light.is_wrong()) << "no marker tells";
}

TEST(LightTracker, ExposureThatChangesDuringAContactIsSaidAndNotFollowed) {
  Pad pad;
  const std::vector<Marker> markers = {moved_by(2)};
  pad.show({4400, 4400, 4400}, kWidth / 4, markers);  // 7.4 %
  EXPECT_TRUE(pad.light.is_wrong());
  pad.show({4200, 4200, 4200}, kWidth / 4, markers);
  EXPECT_FALSE(pad.light.is_wrong());
  pad.show({4600, 3590, 4096}, kWidth / 4, markers);  // a tilted surface: one lamp gains what another loses
  EXPECT_FALSE(pad.light.is_wrong());
  EXPECT_EQ(pad.light.gain(), Rest::unit_gain());
}

TEST(LightTracker, DaylightFromOneSideIsToldFromASlope) {
  Pad pad;
  pad.show({5222, 5222, 5222}, kWidth * 3 / 4);  // 27 % more, and a shade over three quarters: 2 % more there
  EXPECT_TRUE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, {}));
  pad.show({5222, 5222, 4150}, kWidth * 3 / 4);  // not of the third lamp
  EXPECT_FALSE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, {}));
  pad.show({4100, 4100, 4100}, kWidth * 3 / 4);  // darker
  EXPECT_FALSE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, {}));
  pad.show({4340, 4340, 4340});  // 6 %
  EXPECT_TRUE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, {}));
  EXPECT_FALSE(pad.light.is_lit_from_outside(LightTracker::kDaylightOnTrayQ12, {}));
  EXPECT_FALSE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, pad.light.level())) << "everywhere alike";
  pad.rest.load(std::vector<uint16_t>(3 * kPixels, 16 * 20));  // too dark to tell
  pad.light.learn(pad.rest.image(), true);
  pad.show({5222, 5222, 5222});
  EXPECT_FALSE(pad.light.is_lit_from_outside(LightTracker::kDaylightQ12, {}));
}

// The upper half brighter by so much of rest than the lower one, per channel; a contact in the middle is another 20 %.
bool is_one_sided(Pad& pad, std::array<int, 3> more_q12) {
  std::vector<RelativeChange> change(3 * kPixels);
  for (size_t i = 0; i < change.size(); ++i) {
    const size_t y = i % kPixels / kWidth;
    const size_t x = i % kWidth;
    const bool is_touched = y > 12 && y < 36 && x > 10 && x < 50;
    change[i] = RelativeChange::from_raw(
        static_cast<int16_t>((y < kHeight / 2 ? more_q12[i / kPixels] : 0) + (is_touched ? 819 : 0)));
  }
  pad.light.run(change, {}, pad.rest);
  return pad.light.is_lit_from_one_side();
}

TEST(LightTracker, WeakDaylightFromOneSideIsToldUnderAContactToo) {
  Pad pad;
  EXPECT_FALSE(is_one_sided(pad, {0, 0, 0}));
  EXPECT_FALSE(is_one_sided(pad, {82, 120, 120})) << "2 %";
  EXPECT_TRUE(is_one_sided(pad, {83, 120, 120}));
  EXPECT_TRUE(is_one_sided(pad, {-83, -120, -120})) << "from the other side";
  EXPECT_FALSE(is_one_sided(pad, {200, -200, 200})) << "a slope takes from one lamp what it gives to another";
  EXPECT_FALSE(is_one_sided(pad, {200, 200, 0}));
  pad.rest.load(std::vector<uint16_t>(3 * kPixels, 16 * 20));  // too dark to tell
  pad.light.learn(pad.rest.image(), true);
  EXPECT_FALSE(is_one_sided(pad, {200, 200, 200}));
}

TEST(LightTracker, OnlyAMapSaysThatTheLightIsTilted) {
  constexpr int kWide = 320;
  constexpr int kHigh = 240;
  std::vector<RelativeChange> tilted(size_t{3} * kWide * kHigh);
  for (size_t i = 0; i < tilted.size(); ++i) {
    tilted[i] = RelativeChange::from_raw(static_cast<int16_t>((static_cast<int>(i % kWide) - kWide / 2) / 4));  // +-1 %
  }
  for (const bool has_map : {true, false}) {
    Rest rest{kWide, kHigh, 1};
    rest.load(std::vector<uint16_t>(tilted.size(), 16 * 100));
    LightTracker light{kWide, kHigh};
    light.learn(rest.image(), has_map);
    for (int i = 0; i < 3 * LightMap::kWindowFrames; ++i) light.run(tilted, {}, rest);
    EXPECT_EQ(light.is_wrong(), has_map);
  }
}

TEST(LightTracker, StopsAtAQuarterAndGoesOnSayingSo) {
  Pad pad;
  for (int i = 0; i < 1'200; ++i) pad.show({4096 * 3 / 2, 4096 * 3 / 2, 4096 * 3 / 2});
  EXPECT_EQ(pad.gain(1), 1.25);
  EXPECT_TRUE(pad.light.is_wrong());
  pad.light.learn(pad.rest.image(), true);
  EXPECT_EQ(pad.gain(1), 1.0);
}

TEST(LightTracker, WithoutAPixelThatTellsAnythingItSaysNothing) {
  Pad pad;
  pad.rest.load(std::vector<uint16_t>(3 * kPixels, 16 * 20));  // too dark
  pad.light.learn(pad.rest.image(), true);
  for (int i = 0; i < 100; ++i) pad.show(kBluer);
  EXPECT_EQ(pad.light.gain(), Rest::unit_gain());
  EXPECT_FALSE(pad.light.is_wrong());
}

}  // namespace
}  // namespace ruffini
