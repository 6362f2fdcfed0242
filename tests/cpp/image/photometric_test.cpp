#include "image/photometric.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kN = Photometric::kSlopeSize;

// q_x = blue change, q_y = green change (both /1), slope = q: a pad whose colours are its slopes.
struct Tables {
  std::vector<int16_t> unmix;
  std::vector<int16_t> slope;

  Tables() {
    for (int cell = 0; cell < 4; ++cell) {
      for (const int m : {4096, 0, 0, 0, 4096, 0}) unmix.push_back(static_cast<int16_t>(m));
    }
    for (int y = 0; y < kN; ++y) {
      for (int x = 0; x < kN; ++x) {
        slope.push_back(static_cast<int16_t>((x - 32) * 128));  // Q12 of -1 .. 1
        slope.push_back(static_cast<int16_t>((y - 32) * 128));
      }
    }
  }
  [[nodiscard]] PhotometricTable view() const { return view({}); }
  [[nodiscard]] PhotometricTable view(std::span<const int16_t> bend) const {
    PhotometricTable table;
    table.unmix = unmix;
    table.cells = {2, 2};
    table.slope = slope;
    table.bend = bend;
    table.bend_low_q12 = {-2048, -2048, -2048};
    table.bend_shift = {9, 9, 9};
    return table;
  }
};

struct Bench {
  explicit Bench(BoardSettings settings) : board(std::move(settings)), lattice(board), stage(board, tables.view()) {
    lattice.learn(test::exact_dots(test::nominal_dots(board)));
    change.resize(static_cast<size_t>(board.camera.width_px * board.camera.height_px * 3));
    slope.resize(static_cast<size_t>(stage.cells().count()));
  }
  void fill(int blue, int green) {
    const auto n = static_cast<ptrdiff_t>(change.size() / 3);
    std::fill_n(change.begin(), n, RelativeChange::from_raw(static_cast<int16_t>(blue)));
    std::fill_n(change.begin() + n, n, RelativeChange::from_raw(static_cast<int16_t>(green)));
  }

  BoardSettings board;
  Tables tables;
  MarkerTracker lattice;
  Photometric stage;
  std::vector<RelativeChange> change;
  std::vector<CellSlope> slope;
};

TEST(Photometric, ColourBecomesSlopeThroughBothTables) {
  Bench run(test::round_board());
  run.fill(410, -1024);  // +10 %, -25 %
  run.stage.run(run.change, run.lattice.markers(), {}, run.slope);
  for (const CellSlope& s : run.slope) {
    EXPECT_EQ(s.x.raw(), 410);
    EXPECT_EQ(s.y.raw(), -1024);
  }
}

TEST(Photometric, BeyondTheTableTheSlopeIsHeld) {
  Bench run(test::round_board());
  run.fill(32767, -32768);
  run.stage.run(run.change, run.lattice.markers(), {}, run.slope);
  EXPECT_EQ(run.slope[0].x.raw(), 4096);
  EXPECT_EQ(run.slope[0].y.raw(), -4096);
}

TEST(Photometric, WhatADotShowsDoesNotReachTheSlope) {
  for (const int step : {1, 2}) {
    BoardSettings board = test::round_board();
    board.depth.step_px = step;
    Bench run(board);
    auto now = test::nominal_dots(board);
    for (test::Place& p : now) p = {p.x + 3, p.y - 2};
    test::track(run.lattice, test::exact_dots(now));
    run.fill(200, 100);
    // Garbage under the discs at rest and now, 3 px radius.
    const auto spoil = [&](const std::vector<test::Place>& places) {
      for (const test::Place& p : places) {
        for (int y = 0; y < 120; ++y) {
          for (int x = 0; x < 160; ++x) {
            if (std::hypot(x - p.x, y - p.y) <= 3) {
              run.change[static_cast<size_t>(y * 160 + x)] = RelativeChange::from_raw(-3500);
            }
          }
        }
      }
    };
    spoil(test::nominal_dots(board));
    spoil(now);
    run.stage.run(run.change, run.lattice.markers(), {}, run.slope);
    for (const CellSlope& s : run.slope) {
      ASSERT_EQ(s.x.raw(), 200);
      ASSERT_EQ(s.y.raw(), 100);
    }
  }
}

TEST(Photometric, BesideADotShadingIsRead) {
  Bench run(test::round_board());  // dots of 6 px
  const test::Place dot = test::nominal_dots(run.board)[0];
  const auto at = static_cast<size_t>(std::lround(dot.y) * 160 + std::lround(std::ceil(dot.x)) + 5);
  run.change[at] = RelativeChange::from_raw(640);
  run.stage.run(run.change, run.lattice.markers(), {}, run.slope);
  EXPECT_EQ(run.slope[at].x.raw(), 640);
}

TEST(Photometric, UnmixingIsBilinearOverTheImage) {
  BoardSettings board = test::round_board();
  Tables tables;
  tables.unmix[6] = 8192;   // upper right cell: blue counts twice
  tables.unmix[18] = 8192;  // lower right
  Photometric stage(board, tables.view());
  std::vector<RelativeChange> change(160 * 120 * 3);
  std::fill_n(change.begin(), 160 * 120, RelativeChange::from_raw(1000));
  std::vector<CellSlope> slope(160 * 120);
  stage.run(change, {}, {}, slope);
  EXPECT_EQ(slope[0].x.raw(), 1000);
  EXPECT_EQ(slope[159].x.raw(), 2000);
  EXPECT_NEAR(slope[53].x.raw(), 1333, 1);  // one third of the way
}

// Lines at -1/2, -3/8, ... of each colour; only the node at +1/8 of blue says something.
TEST(Photometric, TheBendIsAddedBetweenItsLines) {
  constexpr size_t n = Photometric::kBendSize;
  std::vector<int16_t> bend(n * n * n * 2);
  const size_t node = ((5 * n + 4) * n + 4) * 2;
  bend[node] = 800;
  bend[node + 1] = -400;
  Tables tables;
  const BoardSettings board = test::round_board();
  Photometric stage(board, tables.view(bend));
  std::vector<RelativeChange> change(160 * 120 * 3);
  std::vector<CellSlope> slope(160 * 120);
  const auto at = [&](int blue) {
    std::fill_n(change.begin(), 160 * 120, RelativeChange::from_raw(static_cast<int16_t>(blue)));
    stage.run(change, {}, {}, slope);
    return std::pair<int, int>(slope[77].x.raw(), slope[77].y.raw());
  };
  EXPECT_EQ(at(512), std::pair(512 + 200, -100));  // Q14 800 is Q12 200
  EXPECT_EQ(at(256), std::pair(256 + 100, -50));   // half way to nothing
  EXPECT_EQ(at(896), std::pair(896 + 50, -25));    // three quarters of the way
  EXPECT_EQ(at(0), std::pair(0, 0));
  EXPECT_EQ(at(4096), std::pair(4096, 0));  // beyond the last line its value is held
}

TEST(Photometric, ABalancedTableTakesTheLevelOfTheLightOff) {
  Tables tables;
  PhotometricTable table = tables.view();
  const BoardSettings board = test::round_board();
  std::vector<RelativeChange> change(160 * 120 * 3, RelativeChange::from_raw(1024));  // +25 %
  std::vector<CellSlope> slope(160 * 120);
  const LightLevel level = {6554, -6554, 0};  // +10 %, -10 %
  Photometric(board, table).run(change, {}, level, slope);
  EXPECT_EQ(slope[0].x.raw(), 1024);
  table.is_balanced = true;
  Photometric(board, table).run(change, {}, level, slope);
  EXPECT_NEAR(slope[0].x.raw(), 4096 * (1.25 / 1.1 - 1), 1);
  EXPECT_NEAR(slope[0].y.raw(), 4096 * (1.25 / 0.9 - 1), 1);
}

// A slope that is linear along both axes, and holes in it.
TEST(PhotometricFill, ContinuesALinearSlopeBetweenNeighbours) {
  const GridSize grid{12, 9};
  PhotometricFill fill(grid);
  std::vector<int16_t> n_kept(static_cast<size_t>(grid.count()), 4);
  std::vector<CellSlope> slope;
  for (int i = 0; i < grid.count(); ++i) {
    const int x = i % grid.n_x;
    const int y = i / grid.n_x;
    const bool is_hole = x >= 4 && x < 8 && y >= 3 && y < 6;
    if (is_hole) n_kept[static_cast<size_t>(i)] = 0;
    slope.push_back({Slope::from_raw(static_cast<int16_t>(is_hole ? 9999 : 100 * x)),
                     Slope::from_raw(static_cast<int16_t>(is_hole ? -9999 : 50 * y - 70))});
  }
  fill.run(n_kept, slope);
  EXPECT_NEAR(slope[4 * 12 + 5].x.raw(), 500, 20);  // the middle row: above and below say the same
  EXPECT_EQ(slope[4 * 12 + 5].y.raw(), 130);
  EXPECT_EQ(slope[4 * 12 + 7].y.raw(), 130);
}

TEST(PhotometricFill, FindsASingleMaskedCellAnywhere) {
  const GridSize grid{11, 5};  // cells are looked at four at a time
  PhotometricFill fill(grid);
  for (size_t hole = 0; hole < static_cast<size_t>(grid.count()); ++hole) {
    std::vector<int16_t> n_kept(static_cast<size_t>(grid.count()), 0x100);
    std::vector<CellSlope> slope(n_kept.size(), {Slope::from_raw(300), Slope::from_raw(-70)});
    n_kept[hole] = 0;
    slope[hole] = {Slope::from_raw(9999), Slope::from_raw(9999)};
    fill.run(n_kept, slope);
    EXPECT_EQ(slope[hole].x.raw(), 300) << hole;
    EXPECT_EQ(slope[hole].y.raw(), -70) << hole;
  }
}

TEST(PhotometricFill, WithoutAnyNeighbourItIsZero) {
  PhotometricFill fill({3, 2});
  const std::vector<int16_t> n_kept(6, 0);
  std::vector<CellSlope> slope(6, {Slope::from_raw(7), Slope::from_raw(8)});
  fill.run(n_kept, slope);
  for (const CellSlope& s : slope) {
    EXPECT_EQ(s.x.raw(), 0);
    EXPECT_EQ(s.y.raw(), 0);
  }
}

TEST(PhotometricFill, AtTheBorderItTakesTheOtherSides) {
  PhotometricFill fill({3, 1});
  const std::vector<int16_t> n_kept = {0, 0, 1};
  std::vector<CellSlope> slope(3);
  slope[2] = {Slope::from_raw(40), Slope::from_raw(-40)};
  fill.run(n_kept, slope);
  for (const CellSlope& s : slope) {
    EXPECT_EQ(s.x.raw(), 40);
    EXPECT_EQ(s.y.raw(), -40);
  }
}

}  // namespace
}  // namespace ruffini
