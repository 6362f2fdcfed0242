#include "image/markers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

using test::exact_dots;
using test::nominal_dots;
using test::Place;

constexpr double kPitchPx = 15;
constexpr int kCount = 63;
constexpr int kMiddle = 3 * 9 + 4;

double moved_x(const Marker& m) { return m.displacement_x.raw() / 65536.0; }
double moved_y(const Marker& m) { return m.displacement_y.raw() / 65536.0; }

template <typename Move>
std::vector<Place> moved(std::vector<Place> places, Move move) {
  for (Place& p : places) p = move(p);
  return places;
}

// Every marker rests exactly where its own dot is.
void expect_identity(const MarkerTracker& lattice, const std::vector<Place>& places) {
  for (size_t i = 0; i < places.size(); ++i) {
    const Marker& m = lattice.markers()[i];
    EXPECT_FALSE(m.is_absent);
    EXPECT_NEAR(m.rest_x.raw() / 65536.0, places[i].x, 1e-4) << i;
    EXPECT_NEAR(m.rest_y.raw() / 65536.0, places[i].y, 1e-4) << i;
  }
}

TEST(MarkerTracker, LearnsAPadThatSitsFourTenthsOfAPitchAskew) {
  for (const double sx : {-0.4, 0.0, 0.4}) {
    for (const double sy : {-0.4, 0.0, 0.4}) {
      MarkerTracker lattice(test::round_board());
      const auto places = moved(nominal_dots(test::round_board()),
                                [&](Place p) { return Place{p.x + sx * kPitchPx, p.y + sy * kPitchPx}; });
      EXPECT_EQ(lattice.learn(exact_dots(places)), kCount);
      expect_identity(lattice, places);
    }
  }
}

TEST(MarkerTracker, LearnsATurnedAndScaledPad) {
  const double angle = 4 * std::numbers::pi / 180;
  const auto places = moved(nominal_dots(test::round_board()), [&](Place p) {
    const double x = (p.x - 79.5) * 1.05;
    const double y = (p.y - 59.5) * 1.05;
    return Place{79.5 + x * std::cos(angle) - y * std::sin(angle) + 4,
                 59.5 + x * std::sin(angle) + y * std::cos(angle)};
  });
  MarkerTracker lattice(test::round_board());
  EXPECT_EQ(lattice.learn(exact_dots(places)), kCount);
  expect_identity(lattice, places);
}

TEST(MarkerTracker, ADotThatIsMissingAtRestIsAbsentAndCannotBeLost) {
  auto dots = exact_dots(nominal_dots(test::round_board()));
  dots.erase(dots.begin() + kMiddle);
  MarkerTracker lattice(test::round_board());
  EXPECT_EQ(lattice.learn(dots), kCount - 1);
  EXPECT_TRUE(lattice.markers()[kMiddle].is_absent);
  EXPECT_EQ(test::track(lattice, dots), 0);
  EXPECT_TRUE(lattice.markers()[kMiddle].is_lost);
}

TEST(MarkerTracker, KeepsIdentityOverTwentyPixelsInSmallSteps) {
  MarkerTracker lattice(test::round_board());
  const auto rest = nominal_dots(test::round_board());
  lattice.learn(exact_dots(rest));
  // Shear that grows towards the middle, there and back: the pitch is 15 px, the motion up to 20.
  const int n_steps = 40;
  for (int t = 0; t <= 2 * n_steps; ++t) {
    const double share = (t <= n_steps ? t : 2 * n_steps - t) / static_cast<double>(n_steps);
    const auto now = moved(rest, [&](Place p) {
      const double weight = std::exp(-(std::pow(p.x - 79.5, 2) + std::pow(p.y - 59.5, 2)) / 6000);
      return Place{p.x + 20 * share * weight, p.y - 5 * share * weight};
    });
    auto dots = exact_dots(now);
    std::mt19937 random(static_cast<unsigned>(t));
    std::shuffle(dots.begin(), dots.end(), random);
    ASSERT_EQ(test::track(lattice, dots), 0) << "frame " << t;
    for (size_t i = 0; i < rest.size(); ++i) {
      ASSERT_NEAR(moved_x(lattice.markers()[i]), now[i].x - rest[i].x, 1e-4) << "frame " << t;
      ASSERT_NEAR(moved_y(lattice.markers()[i]), now[i].y - rest[i].y, 1e-4) << "frame " << t;
    }
  }
}

TEST(MarkerTracker, LostMarkersTakeTheirNeighboursMeanAndSaySo) {
  MarkerTracker lattice(test::round_board());
  const auto rest = nominal_dots(test::round_board());
  lattice.learn(exact_dots(rest));
  // Motion linear in x: the mean of the eight neighbours is exactly the lost marker's own.
  auto dots = exact_dots(moved(rest, [](Place p) { return Place{p.x + 0.02 * (p.x - 79.5) + 1.5, p.y}; }));
  dots.erase(dots.begin() + kMiddle);
  EXPECT_EQ(test::track(lattice, dots), 1);
  const Marker& lost = lattice.markers()[kMiddle];
  EXPECT_TRUE(lost.is_lost);
  EXPECT_NEAR(moved_x(lost), 0.02 * (rest[kMiddle].x - 79.5) + 1.5, 1e-3);
  EXPECT_EQ(
      std::count_if(lattice.markers().begin(), lattice.markers().end(), [](const Marker& m) { return m.is_lost; }), 1);
}

TEST(MarkerTracker, FindsAMarkerAgainWhereItsNeighboursWent) {
  MarkerTracker lattice(test::round_board());
  const auto rest = nominal_dots(test::round_board());
  lattice.learn(exact_dots(rest));
  // The middle marker is hidden while the whole field walks 12 px, nearly a pitch, then shows again.
  for (int t = 1; t <= 12; ++t) {
    auto dots = exact_dots(moved(rest, [&](Place p) { return Place{p.x + t, p.y}; }));
    if (t < 12) dots.erase(dots.begin() + kMiddle);
    EXPECT_EQ(test::track(lattice, dots), t < 12 ? 1 : 0);
  }
  EXPECT_FALSE(lattice.markers()[kMiddle].is_lost);
  EXPECT_NEAR(moved_x(lattice.markers()[kMiddle]), 12, 1e-4);
}

TEST(MarkerTracker, KeepsIdentityWhenFramesAreFarApart) {
  const auto rest = nominal_dots(test::round_board());
  // The middle moves by 20 px, more than a pitch, the rim hardly; in single jumps.
  MarkerTracker lattice(test::round_board());
  lattice.learn(exact_dots(rest));
  for (const double peak : {20.0, -20.0, 0.0, 14.0, -17.0, 20.0, 1.0}) {
    const auto now = moved(rest, [&](Place p) {
      const double weight = std::exp(-(std::pow(p.x - 79.5, 2) + std::pow(p.y - 59.5, 2)) / 1800);
      return Place{p.x + peak * weight, p.y - peak / 3 * weight};
    });
    ASSERT_EQ(test::track(lattice, exact_dots(now)), 0) << peak;
    for (size_t i = 0; i < rest.size(); ++i) {
      ASSERT_NEAR(moved_x(lattice.markers()[i]), now[i].x - rest[i].x, 1e-4) << peak << " px, marker " << i;
    }
  }
}

TEST(MarkerTracker, FollowsAJumpOfTheWholePadBeyondHalfAPitch) {
  MarkerTracker lattice(test::round_board());
  const auto rest = nominal_dots(test::round_board());
  lattice.learn(exact_dots(rest));
  for (const double jump : {0.8, 0.0, -0.7}) {
    const auto dots =
        exact_dots(moved(rest, [&](Place p) { return Place{p.x + jump * kPitchPx, p.y + jump / 2 * kPitchPx}; }));
    EXPECT_EQ(test::track(lattice, dots), 0) << jump;
    EXPECT_NEAR(moved_x(lattice.markers()[0]), jump * kPitchPx, 1e-4);
    EXPECT_NEAR(moved_x(lattice.markers()[kMiddle]), jump * kPitchPx, 1e-4);
  }
}

TEST(MarkerTracker, AFrameWithoutDotsLosesAllAndKeepsTheLastMotion) {
  MarkerTracker lattice(test::round_board());
  const auto rest = nominal_dots(test::round_board());
  lattice.learn(exact_dots(rest));
  test::track(lattice, exact_dots(moved(rest, [](Place p) { return Place{p.x + 2, p.y}; })));
  EXPECT_EQ(test::track(lattice, {}), kCount);
  EXPECT_NEAR(moved_x(lattice.markers()[0]), 2, 1e-4);
  EXPECT_TRUE(lattice.markers()[0].is_lost);
}

}  // namespace
}  // namespace ruffini
