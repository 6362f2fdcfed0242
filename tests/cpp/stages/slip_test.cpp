#include "stages/contacts/slip.h"

#include <gtest/gtest.h>

#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kColumns = 17;
constexpr int kRows = 13;
constexpr int16_t kUm = 8;  // steps of displacement

// A square contact of 7 x 7 nodes whose rim may lag behind its middle.
struct Press {
  NodeGrid grid{test::round_board()};
  ContactFinder finder{grid, 10, 300};
  SlipTracker tracker{grid, 10};
  std::vector<uint8_t> mask = std::vector<uint8_t>(kColumns * kRows);
  std::vector<NodeForce> force = std::vector<NodeForce>(kColumns * kRows);
  std::vector<NodeDisplacement> u = std::vector<NodeDisplacement>(kColumns * kRows);

  // Shear over pressure in thousandths, displacement along x in um: of the rim (2 nodes wide) and of the core.
  const ContactSlip& frame(int rim_1e3, int core_1e3, int rim_um, int core_um) {
    for (int y = 3; y < 10; ++y) {
      for (int x = 5; x < 12; ++x) {
        const auto at = static_cast<size_t>(y * kColumns + x);
        const bool is_edge = y == 3 || y == 9 || x == 5 || x == 11;
        const bool is_rim = is_edge || y == 4 || y == 8 || x == 6 || x == 10;
        mask[at] = 1;
        force[at] = {is_edge ? rim_1e3 : core_1e3, 0, -1'000};
        u[at].x = DisplacementUm::from_raw(static_cast<int16_t>((is_rim ? rim_um : core_um) * kUm));
      }
    }
    track();
    return tracker.contacts()[0];
  }
  void track() { tracker.track(finder.find(mask, force, u), finder.component(), force, u); }
  [[nodiscard]] NodeSlip node(int x, int y) const { return tracker.nodes()[static_cast<size_t>(y * kColumns + x)]; }
};

TEST(Slip, TheFirstFrameTellsNothing) {
  Press press;
  EXPECT_EQ(press.frame(0, 0, 0, 0).state, SlipState::kUnknown);
  EXPECT_EQ(press.node(0, 0), NodeSlip::kFree);
  EXPECT_EQ(press.node(8, 6), NodeSlip::kSticks);
}

TEST(Slip, AContactThatMovesAsOneBodySticksAndItsFrictionIsNotKnown) {
  Press press;
  for (int i = 0; i < 20; ++i) {
    const ContactSlip& slip = press.frame(20 * i, 15 * i, 10 * i, 10 * i);
    if (i == 0) continue;
    EXPECT_EQ(slip.state, SlipState::kSticks) << i;
    EXPECT_EQ(slip.friction_1e3, 0);
    EXPECT_EQ(slip.margin_un, 0);
    EXPECT_EQ(slip.share_1e3, 0);
  }
  EXPECT_EQ(press.node(5, 3), NodeSlip::kSticks);
}

TEST(Slip, ARimThatLagsBehindWithEvenShearIsIncipientSlip) {
  Press press;
  press.frame(0, 0, 0, 0);
  press.frame(300, 200, 20, 20);
  const ContactSlip& slip = press.frame(500, 400, 20, 40);
  EXPECT_EQ(slip.state, SlipState::kIncipient);
  EXPECT_NEAR(slip.friction_1e3, 500, 1);
  EXPECT_NEAR(slip.friction_sigma_1e3, 100, 1);
  EXPECT_NEAR(slip.ratio_1e3, (24 * 500 + 25 * 400) / 49, 1);
  EXPECT_EQ(slip.share_1e3, 1'000 * 40 / 49);  // of the 7 x 7 nodes, all but 3 x 3
  // mu F_n - |F_t| = 49 x 500 - (24 x 500 + 25 x 400) steps of 10 uN
  EXPECT_NEAR(static_cast<double>(slip.margin_un), 25'000, 100);
  EXPECT_EQ(press.node(5, 3), NodeSlip::kSlips);
  EXPECT_EQ(press.node(8, 6), NodeSlip::kSticks);
}

TEST(Slip, AllNodesAtTheSameRatioSlide) {
  Press press;
  press.frame(0, 0, 0, 0);
  press.frame(500, 400, 20, 40);
  for (int i = 0; i < 8; ++i) press.frame(500, 500, 20, 40);
  const ContactSlip& slip = press.frame(500, 500, 20, 40);
  EXPECT_EQ(slip.state, SlipState::kSlides);
  EXPECT_NEAR(slip.friction_1e3, 500, 2);
  EXPECT_NEAR(slip.friction_sigma_1e3, 15, 1);  // from a contact that slid
  EXPECT_EQ(slip.share_1e3, 1'000);
  EXPECT_EQ(press.node(8, 6), NodeSlip::kSlips);
  EXPECT_EQ(press.frame(200, 150, 20, 40).state, SlipState::kSticks);
  EXPECT_NEAR(press.tracker.contacts()[0].friction_1e3, 500, 2) << "friction is remembered while it is touched";
}

TEST(Slip, ATurnOfTheWholeContactIsNoSlip) {
  Press press;
  press.frame(100, 80, 0, 0);
  for (int i = 1; i < 8; ++i) {  // 10 um per mm and frame about node (8, 6)
    for (int at = 0; at < kColumns * kRows; ++at) {
      const auto along = [&](int steps) {
        return DisplacementUm::from_raw(static_cast<int16_t>(10 * kUm * i * steps));
      };
      press.u[static_cast<size_t>(at)].x = along(6 - at / kColumns);
      press.u[static_cast<size_t>(at)].y = along(at % kColumns - 8);
    }
    press.track();
    EXPECT_EQ(press.tracker.contacts()[0].state, SlipState::kSticks) << i;
    EXPECT_EQ(press.tracker.contacts()[0].share_1e3, 0) << i;
  }
}

TEST(Slip, ForgettingMakesTheNextFrameTheFirst) {
  Press press;
  press.frame(0, 0, 0, 0);
  press.frame(500, 400, 20, 40);
  press.tracker.forget();
  EXPECT_EQ(press.frame(500, 500, 20, 40).state, SlipState::kUnknown);
  EXPECT_EQ(press.frame(300, 200, 20, 40).friction_1e3, 0);
}

}  // namespace
}  // namespace ruffini
