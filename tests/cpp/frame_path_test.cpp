#include "frame_path.h"

#include <gtest/gtest.h>

#include <cstdlib>

#include "support/dot_picture.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

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
  EXPECT_EQ(s.force.xy, Validity::kNotMeasured);
  EXPECT_EQ(s.force.z, Validity::kNotMeasured);
  EXPECT_EQ(s.depth.validity, Validity::kNotMeasured);
  for (const NodeDisplacement& u : s.displacement.node) {
    EXPECT_NEAR(u.x.raw() / 8.0, 150, 12);  // 1.5 px of 100 um; 0.1 px where extrapolated
    EXPECT_EQ(u.z.raw(), 0);
  }
  EXPECT_EQ(s.wrench.sum, Wrench{});
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

TEST(FramePath, AStartThatNobodyCanCompareIsUnverifiedUntilSomebodyZeroes) {
  Sensor sensor;
  sensor.path->expect_rest({});
  sensor.learn();
  EXPECT_TRUE(sensor.show_dots(0).flags & kFlagRestUnverified);
  EXPECT_EQ(sensor.path->rest_watch().n_accepted, 0U);
  sensor.path->zero(2);
  for (int i = 0; i < 2; ++i) sensor.show_dots(0);
  EXPECT_FALSE(sensor.show_dots(0).flags & (kFlagRestUnverified | kFlagNoReference));
  EXPECT_EQ(sensor.path->rest_watch().n_accepted, 1U);
}

TEST(FramePath, AZeroThatIsGivenUpLeavesTheOldOne) {
  Sensor sensor;
  sensor.learn();
  const int32_t moved = sensor.show_dots(2).displacement.node[100].x.raw();
  EXPECT_GT(moved / 8.0, 100);
  sensor.path->zero(3);
  EXPECT_TRUE(sensor.show_dots(2).flags & kFlagNoReference);
  EXPECT_TRUE(sensor.path->is_zeroing());
  sensor.path->cancel_zero();
  EXPECT_FALSE(sensor.path->is_zeroing());
  const FrameState& s = sensor.show_dots(2);
  EXPECT_FALSE(s.flags & kFlagNoReference);
  EXPECT_NEAR(s.displacement.node[100].x.raw() / 8.0, moved / 8.0, 3);
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

// A pressed pad whose calibration states its uncertainty; with capture times of 60 Hz.
struct PressedSensor {
  explicit PressedSensor(bool is_relaxing = false, bool has_rest = true) {
    // Contacts of a skin that glows and of a texture are their own.
    board.stages = test::stages_but({"skin", "contact_model", "helmholtz"});
    auto file = CalibrationFile::load(test::diagonal_calibration(board, is_relaxing));
    EXPECT_TRUE(file.has_value());
    path = std::move(FramePath::configure(board, file.value(), fake_clock)).value();
    if (has_rest) learn();
  }
  void learn() {
    for (int i = 0; i < board.n_rest_frames; ++i) still();
  }
  const FrameState& still() { return show(test::nominal_dots(board), 0); }
  // All dots moved by two pixels but the `hidden` one; shaded as by a dent in the middle.
  const FrameState& press(int hidden) {
    auto dots = test::nominal_dots(board);
    for (test::Place& p : dots) p.x += 2;
    if (hidden >= 0) dots.erase(dots.begin() + hidden);
    return show(dots, 1);
  }
  const FrameState& show_level(uint8_t level) {
    return process(
        std::vector<uint8_t>(static_cast<size_t>(3 * board.camera.width_px * board.camera.height_px), level));
  }

  BoardSettings board = test::round_board();
  std::unique_ptr<FramePath> path;

 private:
  const FrameState& process(const std::vector<uint8_t>& pixels) {
    const ptrdiff_t stride = ptrdiff_t{3} * board.camera.width_px;
    return path->process({pixels.data(), board.camera.width_px, board.camera.height_px, 3, stride}, now_us_ += 16'667);
  }
  const FrameState& show(const std::vector<test::Place>& dots, int steep) {
    const int width = board.camera.width_px;
    const int height = board.camera.height_px;
    std::vector<uint8_t> pixels = DotPicture{.noise = 0}.bgr(dots, 1);
    for (int i = 0; i < width * height; ++i) {
      const int dx = i % width - width / 2;
      const int dy = i / width - height / 2;
      if (dx * dx + dy * dy > height * height / 16) continue;
      uint8_t* pixel = &pixels[static_cast<size_t>(3 * i)];
      pixel[0] = static_cast<uint8_t>(std::clamp(pixel[0] + steep * dx, 0, 255));
      pixel[1] = static_cast<uint8_t>(std::clamp(pixel[1] + steep * dy, 0, 255));
    }
    return process(pixels);
  }
  uint64_t now_us_ = 0;
};

// The promise of the product: a force that may be wrong is never called valid.
TEST(FramePath, WhatAWrongFrameSaysIsInvalidInEveryQuantity) {
  PressedSensor sensor;
  const auto all = [](const FrameState& s) {
    std::vector<Validity> out(s.wrench.validity.begin(), s.wrench.validity.end());
    out.insert(out.end(), {s.force.xy, s.force.z, s.depth.validity, s.uncertainty.validity, s.covariance.validity});
    return out;
  };
  const std::vector<Validity> valid(11, Validity::kValid);
  const std::vector<Validity> invalid(11, Validity::kInvalid);
  EXPECT_EQ(all(sensor.press(-1)), valid);
  EXPECT_EQ(all(sensor.show_level(2)), invalid) << "a covered lens";
  EXPECT_EQ(all(sensor.show_level(255)), invalid) << "light from outside";
  EXPECT_EQ(all(sensor.press(-1)), valid) << "it must recover";
  sensor.path->zero(2);
  for (const Validity v : all(sensor.press(-1))) {
    EXPECT_TRUE(v == Validity::kInvalid || v == Validity::kNotMeasured) << "no rest to compare with";
  }
}

// Of a camera alone: a recording may well show the same picture twice.
TEST(FramePath, ARepeatedOrBrokenPictureOfACameraIsFlaggedAndNoForceIsValid) {
  PressedSensor sensor;
  EXPECT_FALSE(sensor.press(-1).flags & kWrongFlags);
  EXPECT_FALSE(sensor.press(-1).flags & kWrongFlags);
  sensor.path->set_live(true);
  (void)sensor.press(-1);
  const FrameState& again = sensor.press(-1);
  EXPECT_EQ(again.flags & kWrongFlags, uint32_t{kFlagRepeated});
  EXPECT_EQ(again.force.z, Validity::kInvalid);
  const FrameState& blank = sensor.show_level(40);
  EXPECT_TRUE(blank.flags & kFlagLight);
  EXPECT_FALSE(blank.flags & kFlagRepeated);
  sensor.path->set_capture_flags(kFlagTime);
  const FrameState& other = sensor.press(-1);
  EXPECT_TRUE(other.flags & kFlagTime);
  EXPECT_TRUE(other.flags & kFlagRepeated) << "an older picture than the last";
}

TEST(FramePath, ATouchIsKnownAsOneAndAFrameThatIsWrongIsNone) {
  PressedSensor sensor;
  EXPECT_TRUE(sensor.press(-1).contacts.n_found > 0);
  EXPECT_TRUE(sensor.path->is_touched());
  (void)sensor.show_level(40);
  EXPECT_FALSE(sensor.path->is_touched());
}

TEST(FramePath, AZeroIsRefusedWhereSomethingPressesWhileItLearns) {
  PressedSensor sensor;
  const int64_t pressed = sensor.press(-1).wrench.sum.force_z_un;
  sensor.still();
  sensor.path->zero(9);
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(sensor.still().flags & kFlagNoReference);
  EXPECT_EQ(sensor.path->rest_watch().n_refused, 0U);
  EXPECT_EQ(sensor.press(-1).force.z, Validity::kInvalid);
  EXPECT_EQ(sensor.path->rest_watch().n_refused, 1U);
  EXPECT_FALSE(sensor.path->is_zeroing());
  const FrameState& s = sensor.press(-1);
  EXPECT_EQ(s.force.z, Validity::kValid);
  EXPECT_EQ(s.wrench.sum.force_z_un, pressed) << "rest is what it was";
  sensor.path->zero(2, false);
  for (int i = 0; i < 2; ++i) sensor.press(-1);
  EXPECT_NEAR(static_cast<double>(sensor.press(-1).wrench.sum.force_z_un), 0, 1'000) << "as somebody asked";
}

TEST(FramePath, AZeroIsRefusedWhereMarkersVanishWhileItLearns) {
  PressedSensor sensor;
  sensor.still();
  sensor.path->zero(9);
  sensor.still();
  EXPECT_TRUE(sensor.show_level(40).flags & kFlagMarkersLost) << "as under a press that is too strong";
  EXPECT_FALSE(sensor.path->is_zeroing());
  EXPECT_EQ(sensor.path->rest_watch().n_refused, 1U);
  sensor.show_level(40);
  sensor.path->zero(2);  // what was so before may be why somebody zeroes
  for (int i = 0; i < 2; ++i) sensor.show_level(40);
  EXPECT_FALSE(sensor.path->is_zeroing());
  EXPECT_EQ(sensor.path->rest_watch().n_refused, 1U);
}

TEST(FramePath, AZeroThatAPressEndedDoesNotVerifyTheStart) {
  PressedSensor sensor(false, false);
  sensor.path->expect_rest({});
  for (int i = 0; i <= sensor.board.n_rest_frames; ++i) (void)sensor.still();
  sensor.path->zero(9);
  sensor.press(-1);
  EXPECT_FALSE(sensor.path->is_zeroing());
  for (int i = 0; i <= sensor.board.n_rest_frames; ++i) EXPECT_TRUE(sensor.still().flags & kFlagRestUnverified);
}

TEST(FramePath, AStartIsComparedWithTheRestOfTheRunBefore) {
  PressedSensor before;
  const int64_t pressed = before.press(-1).wrench.sum.force_z_un;
  const auto start = [&](bool is_pressed) {
    PressedSensor sensor(false, false);
    sensor.path->expect_rest(before.path->rest_image());
    for (int i = 0; i < sensor.board.n_rest_frames; ++i) (void)(is_pressed ? sensor.press(-1) : sensor.still());
    const FrameState& s = sensor.press(-1);
    EXPECT_FALSE(s.flags & kFlagNoReference);
    EXPECT_EQ((s.flags & kFlagRestUnverified) != 0, is_pressed) << "a load, or no longer that pad";
    EXPECT_NEAR(static_cast<double>(s.wrench.sum.force_z_un), static_cast<double>(pressed), 1'000);
    for (int i = 0; i < sensor.board.n_rest_frames; ++i) (void)sensor.still();
    EXPECT_FALSE(sensor.press(-1).flags & kFlagRestUnverified) << "untouched it reads zero: it was a load";
    return std::pair{sensor.path->rest_watch().n_refused, sensor.path->rest_watch().n_accepted};
  };
  EXPECT_EQ(start(false), (std::pair{0U, 1U}));
  EXPECT_EQ(start(true), (std::pair{1U, 0U})) << "under a load: the rest of before stays";
  PressedSensor dark(false, false);  // pictures that show nothing are compared with nothing
  dark.path->expect_rest(before.path->rest_image());
  for (int i = 0; i < dark.board.n_rest_frames; ++i) dark.show_level(5);
  EXPECT_TRUE(dark.still().flags & kFlagRestUnverified);
  EXPECT_EQ(dark.path->rest_watch().n_accepted, 0U);
}

// The relaxation of an old press must not be subtracted from later forces once rest has been learned again.
TEST(FramePath, ANewRestForgetsWhatThePadWentThrough) {
  const auto relearnt = [](PressedSensor& sensor) {
    sensor.learn();
    return sensor.press(-1).wrench.sum.force_x_un;
  };
  PressedSensor fresh(true);
  fresh.path->zero(fresh.board.n_rest_frames);
  const int64_t rested = relearnt(fresh);
  ASSERT_GT(rested, 0);
  PressedSensor held(true);
  for (int i = 0; i < 60; ++i) held.press(-1);
  EXPECT_LT(held.press(-1).wrench.sum.force_x_un, rested * 9 / 10) << "it relaxes while held";
  held.path->zero(held.board.n_rest_frames);
  EXPECT_EQ(relearnt(held), rested);
  for (int i = 0; i < 60; ++i) held.press(-1);
  const std::vector<uint16_t> rest(fresh.path->rest_image().begin(), fresh.path->rest_image().end());
  held.path->set_rest(rest);
  fresh.path->set_rest(rest);
  EXPECT_EQ(held.press(-1).wrench.sum.force_x_un, fresh.press(-1).wrench.sum.force_x_un);
}

TEST(FramePath, ALostMarkerMakesShearLessSureThereAndLeavesTheForceNearWhatItWas) {
  PressedSensor sensor;
  const FrameState whole = sensor.press(-1);
  ASSERT_TRUE(whole.uncertainty.is_stated);
  ASSERT_EQ(whole.contacts.n_found, 1);
  const int hidden = 3 * 9 + 4;  // the middle one, upon node (8, 6)
  const FrameState& fewer = sensor.press(hidden);
  ASSERT_EQ(fewer.markers.n_lost, 1);
  ASSERT_TRUE(fewer.uncertainty.is_stated);
  const size_t middle = 6 * 17 + 8;
  for (size_t i = 0; i < whole.solve.force.size(); ++i) {
    const bool is_there = i == middle;
    EXPECT_EQ(fewer.displacement.filled[i] != 0, is_there) << i;
    const int64_t limit = 400;  // steps of 20,000: the dent's slopes make 2 % of a dot's place
    EXPECT_NEAR(fewer.solve.force[i].x, whole.solve.force[i].x, limit) << i;
    EXPECT_NEAR(fewer.uncertainty.node[i].z, whole.uncertainty.node[i].z, limit) << i;
    const double growth = fewer.uncertainty.node[i].x / static_cast<double>(whole.uncertainty.node[i].x);
    const bool is_beside = std::abs(static_cast<int>(i % 17) - 8) <= 1 && std::abs(static_cast<int>(i / 17) - 6) <= 1;
    EXPECT_NEAR(growth, is_there ? 2.5 : is_beside ? 1.5 : 1, 0.1) << i;
  }
  EXPECT_GT(whole.solve.force[middle].x, 20'000);  // 200 um x 8 x 20
  EXPECT_GT(fewer.covariance.wrench.upper[0], whole.covariance.wrench.upper[0]);
  sensor.press(-1);
  EXPECT_EQ(fewer.covariance.wrench.upper[0], whole.covariance.wrench.upper[0]) << "it must recover";
}

TEST(FramePath, TimesEveryStageThatRan) {
  Sensor sensor;
  sensor.learn();
  const FrameState& s = sensor.show_dots(0);
  EXPECT_EQ(s.stage_ns[stage_row("difference")], 1'000U);
  EXPECT_EQ(s.stage_ns[stage_row("markers")], 1'000U);
  EXPECT_EQ(s.stage_ns[stage_row("poisson")], 0U);
}

}  // namespace
}  // namespace ruffini
