#include "stages/contacts/contacts.h"

#include <gtest/gtest.h>

#include "support/test_board.h"

namespace ruffini {
namespace {

struct Pad {
  explicit Pad(const BoardSettings& board = test::round_board()) : grid(board) {}

  NodeGrid grid;
  ContactFinder finder{grid, 10, 300};
  std::vector<uint8_t> mask = std::vector<uint8_t>(17 * 13);
  std::vector<NodeForce> force = std::vector<NodeForce>(17 * 13);
  std::vector<NodeDisplacement> u = std::vector<NodeDisplacement>(17 * 13);

  void touch(int column, int row, int32_t fz, int16_t uz) {
    const auto at = static_cast<size_t>(row * 17 + column);
    mask[at] = 1;
    force[at] = {5, -7, fz};
    u[at].z = DisplacementUm::from_raw(uz);
  }
  ContactList find() { return finder.find(mask, force, u); }
};

TEST(Contacts, NothingTouchedIsNoContact) {
  Pad pad;
  EXPECT_EQ(pad.find().n_found, 0);
  EXPECT_EQ(pad.find().n_listed, 0);
}

TEST(Contacts, TwoContactsLargestFirstWithTheirOwnSums) {
  Pad pad;
  pad.touch(2, 3, -100, -80);
  pad.touch(3, 4, -300, -160);  // touches the first one over the corner
  pad.touch(12, 9, -100, -8);
  pad.touch(13, 9, -100, -16);
  pad.touch(14, 9, -200, -24);
  const ContactList list = pad.find();
  ASSERT_EQ(list.n_found, 2);
  const Contact& large = list.contacts[0];
  EXPECT_EQ(large.n_nodes, 3);
  EXPECT_EQ(large.area_um2, 3'000'000);
  EXPECT_EQ(large.force_x_un, 150);
  EXPECT_EQ(large.force_y_un, -210);
  EXPECT_EQ(large.force_z_un, -4'000);
  EXPECT_EQ(large.center_x_um, 5'250);  // (4000 + 5000 + 2 x 6000) / 4
  EXPECT_EQ(large.center_y_um, 3'000);
  EXPECT_EQ(large.peak_depth_nm, -3'000);
  const Contact& small = list.contacts[1];
  EXPECT_EQ(small.n_nodes, 2);
  EXPECT_EQ(small.center_x_um, -5'250);  // (-6000 - 3 x 5000) / 4
  EXPECT_EQ(small.peak_depth_nm, -20'000);
}

TEST(Contacts, NodesThatPullAreSummedButNotCountedAsArea) {
  Pad pad;
  pad.touch(5, 5, -100, 0);
  pad.touch(6, 5, 40, 0);
  const ContactList list = pad.find();
  ASSERT_EQ(list.n_found, 1);
  EXPECT_EQ(list.contacts[0].n_nodes, 1);
  EXPECT_EQ(list.contacts[0].force_z_un, -600);
  EXPECT_EQ(list.contacts[0].center_x_um, -3'000);
}

TEST(Contacts, AComponentInWhichNoNodePressesIsNone) {
  Pad pad;
  pad.touch(2, 3, 0, -80);
  pad.touch(3, 3, 40, -80);
  pad.touch(12, 9, -100, -8);
  const ContactList list = pad.find();
  ASSERT_EQ(list.n_found, 1);
  EXPECT_EQ(list.contacts[0].force_z_un, -1'000);
}

TEST(Contacts, ListsTheEightLargestOfMany) {
  Pad pad;
  // Ten contacts in every second row and column; those of row 6 are two nodes wide.
  for (int i = 0; i < 5; ++i) {
    pad.touch(3 * i, 0, -100, 0);
    pad.touch(3 * i, 6, -100, 0);
    pad.touch(3 * i + 1, 6, -100, 0);
  }
  const ContactList list = pad.find();
  EXPECT_EQ(list.n_found, 10);
  ASSERT_EQ(list.n_listed, 8);
  for (int i = 0; i < 8; ++i) EXPECT_EQ(list.contacts[static_cast<size_t>(i)].n_nodes, i < 5 ? 2 : 1) << i;
}

// Nodes 2 to 14 and 0 to 10 of 17 x 13: the pad goes on at three sides.
BoardSettings windowed_board() {
  BoardSettings board = test::round_board();
  board.window = {.min_x_um = 2'000, .min_y_um = 0, .max_x_um = 14'000, .max_y_um = 10'000};
  return board;
}

struct WindowedPad {
  NodeGrid grid{windowed_board()};
  ContactFinder finder{grid, 10, 300};

  // Of one contact of three nodes in a row, the first one pressed by fz.
  ContactList press(int column, int row, int32_t fz) {
    std::vector<uint8_t> mask(13 * 11);
    std::vector<NodeForce> force(13 * 11);
    for (int i = 0; i < 3; ++i) {
      const auto at = static_cast<size_t>(row * 13 + column + i);
      mask[at] = 1;
      force[at].z = i == 0 ? fz : -10;
    }
    return finder.find(mask, force, std::vector<NodeDisplacement>(13 * 11));
  }
};

TEST(Contacts, ThoseThatPressOnTheWindowsBorderSaySo) {
  WindowedPad pad;
  EXPECT_TRUE(pad.press(0, 5, -301).reaches_border);
  EXPECT_TRUE(pad.press(0, 5, -301).contacts[0].reaches_border);
  EXPECT_TRUE(pad.press(4, 10, -301).reaches_border);
  EXPECT_FALSE(pad.press(0, 5, -300).reaches_border) << "at the threshold, not above it";
  EXPECT_FALSE(pad.press(1, 5, -301).reaches_border) << "one line inside";
  EXPECT_FALSE(pad.press(4, 0, -301).reaches_border) << "there the pad itself ends";
}

TEST(Contacts, AWindowThatIsTheWholePadHasNoBorder) {
  Pad pad;
  pad.touch(0, 5, -3'000, -8);
  EXPECT_FALSE(pad.find().reaches_border);
}

}  // namespace
}  // namespace ruffini
