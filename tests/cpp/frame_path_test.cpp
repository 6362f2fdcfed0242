#include "frame_path.h"

#include <gtest/gtest.h>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

using test::DotPicture;

uint64_t fake_now = 0;
uint64_t fake_clock() { return fake_now += 1'000; }

struct Sensor {
  explicit Sensor(BoardSettings settings = test::round_board())
      : board(std::move(settings)), path(std::move(FramePath::configure(board, nullptr, fake_clock)).value()) {}

  const FrameState& show(const std::vector<uint8_t>& pixels) {
    return path->process(
        {pixels.data(), board.camera.width_px, board.camera.height_px, 3, ptrdiff_t{3} * board.camera.width_px});
  }
  // One frame of the pad with all dots moved by (dx, 0) pixels.
  const FrameState& show_dots(double dx, double level = 120) {
    auto dots = test::nominal_dots(board);
    for (test::Place& p : dots) p.x += dx;
    return show(DotPicture{.level = level}.bgr(dots, ++seed_));
  }
  void learn() {
    for (int i = 0; i < board.n_rest_frames; ++i) show_dots(0);
  }

  BoardSettings board;
  std::unique_ptr<FramePath> path;

 private:
  unsigned seed_ = 0;
};

TEST(FramePath, SaysThatThereIsNoReferenceWhileItLearns) {
  Sensor sensor;
  EXPECT_TRUE(sensor.show_dots(0).flags & kFlagNoReference);
  EXPECT_TRUE(sensor.show_dots(0).flags & kFlagNoReference);
  EXPECT_FALSE(sensor.show_dots(0).flags & kFlagNoReference);
  EXPECT_EQ(sensor.path->n_markers_at_rest(), 63);
}

TEST(FramePath, MeasuresDisplacementWithoutAnyCalibrationAndNoForce) {
  Sensor sensor;
  sensor.learn();
  const FrameState& s = sensor.show_dots(1.5);
  EXPECT_EQ(s.flags, kFlagUncalibratedXy | kFlagUncalibratedZ);
  EXPECT_EQ(s.force_xy, Validity::kNotMeasured);
  EXPECT_EQ(s.force_z, Validity::kNotMeasured);
  EXPECT_EQ(s.depth_validity, Validity::kNotMeasured);
  for (const NodeDisplacement& u : s.displacement.node) {
    EXPECT_NEAR(u.x.raw() / 8.0, 150, 12);  // 1.5 px of 100 um; 0.1 px where extrapolated
    EXPECT_EQ(u.z.raw(), 0);
  }
  EXPECT_EQ(s.wrench, Wrench{});
}

TEST(FramePath, ZeroLearnsAnew) {
  Sensor sensor;
  sensor.learn();
  sensor.path->zero(3);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(sensor.show_dots(2).flags & kFlagNoReference);
  const FrameState& s = sensor.show_dots(2);
  EXPECT_FALSE(s.flags & kFlagNoReference);
  EXPECT_NEAR(s.displacement.node[100].x.raw() / 8.0, 0, 10);
}

TEST(FramePath, FlagsDarknessGlareAndLostMarkers) {
  Sensor sensor;
  sensor.learn();
  const size_t n_values = 160 * 120 * 3;
  const uint32_t dark = sensor.show(std::vector<uint8_t>(n_values, 2)).flags;
  EXPECT_TRUE(dark & kFlagDark);
  EXPECT_TRUE(dark & kFlagMarkersLost);
  EXPECT_FALSE(dark & kFlagOverexposed);
  const uint32_t bright = sensor.show(std::vector<uint8_t>(n_values, 255)).flags;
  EXPECT_TRUE(bright & kFlagOverexposed);
  EXPECT_FALSE(bright & kFlagDark);
  EXPECT_EQ(sensor.show_dots(0).flags, kFlagUncalibratedXy | kFlagUncalibratedZ) << "it must recover";
}

TEST(FramePath, FlagsWhatTheLinearModelWasNotMadeFor) {
  Sensor sensor;
  sensor.learn();
  for (const double dx : {5.0, 10.0, 15.0}) EXPECT_FALSE(sensor.show_dots(dx).flags & kFlagOverRange) << dx;
  // Half the thickness of 4 mm is 20 px.
  EXPECT_TRUE(sensor.show_dots(21).flags & kFlagOverRange);
}

TEST(FramePath, APadWithoutDotsIsNotThisBoard) {
  Sensor sensor;
  const std::vector<uint8_t> blank(160 * 120 * 3, 120);
  for (int i = 0; i < 3; ++i) sensor.show(blank);
  EXPECT_TRUE(sensor.show(blank).flags & kFlagMarkersLost);
}

TEST(FramePath, TimesEveryStageThatRan) {
  Sensor sensor;
  sensor.learn();
  const FrameState& s = sensor.show_dots(0);
  EXPECT_EQ(s.stage_ns[static_cast<size_t>(Stage::kDifference)], 1'000U);
  EXPECT_EQ(s.stage_ns[static_cast<size_t>(Stage::kMarkers)], 1'000U);
  EXPECT_EQ(s.stage_ns[static_cast<size_t>(Stage::kPoisson)], 0U);
}

}  // namespace
}  // namespace ruffini
