#include "image/kernels.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <random>
#include <string>

#include "base/processor.h"
#include "support/test_board.h"

namespace ruffini::kernels {
namespace {

struct Version {
  std::string name;
  const Kernels* kernels;
};

// All but the reference.
std::vector<Version> versions() {
  std::vector<Version> out = {{"neon", &kNeon}};
#if defined(__x86_64__)
  if (has_avx2()) out.push_back({"avx2", &kAvx2});
#endif
  return out;
}

struct Solved {
  std::vector<DisplacementUm> depth;
  uint64_t saturations = 0;
  bool operator==(const Solved&) const = default;
};

Solved solve(const BoardSettings& board, PoissonRun version, const std::vector<CellSlope>& slope) {
  Poisson poisson(board, version);
  Solved out{std::vector<DisplacementUm>(slope.size()), 0};
  SaturationCounter counter;
  poisson.run(slope, out.depth, counter);
  poisson.run(slope, out.depth, counter);  // what the first run left behind does not matter
  out.saturations = counter.count;
  return out;
}

#if defined(__x86_64__)
TEST(Kernels, Avx2IsFoundWhereLinuxListsIt) {
  std::ifstream file("/proc/cpuinfo");
  const std::string told((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(has_avx2(), told.find(" avx2") != std::string::npos);
}
#endif

TEST(Kernels, PoissonIsTheSameAtAnySizeAndSlope) {
  std::mt19937 random(11);  // NOLINT: the same numbers on every run
  for (const auto& [width, height] : {std::pair{160, 120}, {66, 42}, {63, 41}, {31, 17}, {16, 16}, {49, 90}}) {
    for (const int limit : {1, 400, 32'767}) {
      BoardSettings board = test::round_board();
      board.camera.width_px = width;
      board.camera.height_px = height;
      board.depth.step_px = 1;
      std::uniform_int_distribution<int> any(-limit, limit);
      const auto one = [&] { return Slope::from_raw(static_cast<int16_t>(any(random))); };
      std::vector<CellSlope> slope(static_cast<size_t>(width * height));
      for (CellSlope& s : slope) s = {one(), one()};
      const Solved reference = solve(board, kScalar.poisson, slope);
      EXPECT_EQ(reference.saturations > 0, limit == 32'767) << width << "x" << height << ", slopes to " << limit;
      for (const Version& version : versions()) {
        EXPECT_EQ(solve(board, version.kernels->poisson, slope), reference)
            << version.name << ", " << width << "x" << height << ", slopes to " << limit;
      }
    }
  }
}

TEST(Kernels, PoissonOfOneSteepPlaneSaturatesAlike) {
  for (const int16_t raw : {int16_t{32'767}, int16_t{-32'768}}) {
    const BoardSettings board = test::round_board();
    const std::vector<CellSlope> slope(160 * 120, {Slope::from_raw(raw), Slope::from_raw(raw)});
    const Solved reference = solve(board, kScalar.poisson, slope);
    EXPECT_GT(reference.saturations, 0U);
    for (const Version& version : versions()) {
      EXPECT_EQ(solve(board, version.kernels->poisson, slope), reference) << version.name;
    }
  }
}

struct Row {
  std::vector<int16_t> change;
  std::vector<uint16_t> grey;
  ExposureCounts counts;
};

Row difference_row(const Kernels& kernels, std::span<const uint8_t> pixels, std::span<const int16_t> rest8,
                   std::span<const int16_t> reciprocal) {
  const size_t width = pixels.size() / 3;
  Row out{std::vector<int16_t>(3 * width + 5), std::vector<uint16_t>(width), {}};
  out.counts = kernels.difference({.pixels = pixels.data(),
                                   .width = static_cast<int>(width),
                                   .rest8 = rest8.data(),
                                   .reciprocal = reciprocal.data(),
                                   .plane = static_cast<ptrdiff_t>(width),
                                   .change = out.change.data(),
                                   .grey = out.grey.data()});
  return out;
}

TEST(Kernels, DifferenceIsTheSameAtAnyWidthAndAlignment) {
  std::mt19937 random(12);  // NOLINT: the same numbers on every run
  for (size_t width = 1; width < 70; ++width) {
    const size_t offset = random() % 16;
    std::vector<uint8_t> pixels(3 * width + offset);
    for (uint8_t& level : pixels) level = static_cast<uint8_t>(random() % 4 == 0 ? random() % 12 : 248 + random() % 8);
    std::vector<int16_t> rest8(3 * width);
    std::vector<int16_t> reciprocal(3 * width);
    for (int16_t& r : rest8) r = static_cast<int16_t>(random() % 32'641);
    for (int16_t& r : reciprocal) r = static_cast<int16_t>(4'112 + random() % 28'656);
    const auto row = std::span<const uint8_t>(pixels).subspan(offset);
    const Row reference = difference_row(kScalar, row, rest8, reciprocal);
    for (const Version& version : versions()) {
      const Row other = difference_row(*version.kernels, row, rest8, reciprocal);
      EXPECT_EQ(other.change, reference.change) << version.name << " " << width;
      EXPECT_EQ(other.grey, reference.grey) << version.name << " " << width;
      EXPECT_EQ(other.counts.dark, reference.counts.dark) << version.name << " " << width;
      EXPECT_EQ(other.counts.full, reference.counts.full) << version.name << " " << width;
    }
  }
}

TEST(Kernels, WeightsOfDotsAreTheSameAtAnyWidth) {
  std::mt19937 random(14);  // NOLINT: the same numbers on every run
  for (int width = 1; width < 60; ++width) {
    const int radius = 2 + width % 7;
    const auto n = static_cast<size_t>(width);
    std::vector<uint16_t> rows[3];
    for (auto& row : rows) {
      for (size_t i = 0; i < n; ++i) row.push_back(static_cast<uint16_t>(random() % 12'241));
    }
    const std::vector<int32_t> inverse(n, (1 << 29) / (width + 1));
    std::vector<int16_t> open(n / DotTiles::kSide + 1);
    for (int16_t& tile : open) tile = static_cast<int16_t>(random() % 3);
    const auto run = [&](const Kernels& kernels, bool is_light) {
      std::vector<int32_t> sums(n, 300'000);
      std::vector<int32_t> prefix(n + 2 * static_cast<size_t>(radius) + 1);
      std::vector<int16_t> weight(n, -1);
      kernels.dots.weigh({.width = width,
                          .box_radius_px = radius,
                          .is_light = is_light,
                          .threshold_q15 = 3'932,
                          .entering = rows[0].data(),
                          .leaving = rows[1].data(),
                          .grey = rows[2].data(),
                          .open = open.data(),
                          .inverse_q32 = inverse.data(),
                          .column_sum = sums.data(),
                          .prefix_sum = prefix.data(),
                          .weight = weight.data()});
      return std::pair{sums, weight};
    };
    for (const bool is_light : {false, true}) {
      const auto reference = run(kScalar, is_light);
      for (const Version& version : versions()) {
        EXPECT_EQ(run(*version.kernels, is_light), reference) << version.name << ", width " << width;
      }
    }
  }
}

struct Tiles {
  std::vector<int32_t> column, min_grey, max_grey, sum, wide, added, levels;
  std::vector<int16_t> open;
  bool operator==(const Tiles&) const = default;
};

TEST(Kernels, TilesOfDotsAreTheSameAtAnySize) {
  std::mt19937 random(15);  // NOLINT: the same numbers on every run
  for (int width = 1; width < 70; ++width) {
    const int n_rows = 1 + width % 8;
    const int n_tiles = (width + 7) / 8;
    const auto n = static_cast<size_t>(width);
    const auto many = [&](size_t count, int from, int to) {
      std::vector<int32_t> out(count);
      for (int32_t& v : out)
        v = from + static_cast<int32_t>(random() % (static_cast<unsigned>(to) - static_cast<unsigned>(from)));
      return out;
    };
    std::vector<uint16_t> grey(n * static_cast<size_t>(n_rows));
    for (uint16_t& g : grey) g = static_cast<uint16_t>(random() % 12'241);
    const auto columns = many(n, 0, 57);
    const std::vector<std::vector<int32_t>> corners{many(n, -(1 << 30), 1 << 30), many(n, -(1 << 30), 1 << 30)};
    const auto insides = many(n, 0, 30'000'000);
    const auto min_grey = many(n, 0, 12'241);
    const auto max_grey = many(n, 0, 12'241);
    const auto run = [&](const TileKernels& kernels, bool is_light) {
      const auto count = static_cast<size_t>(n_tiles);
      Tiles out{std::vector<int32_t>(n),
                std::vector<int32_t>(count),
                std::vector<int32_t>(count),
                std::vector<int32_t>(count),
                min_grey,
                columns,
                columns,
                std::vector<int16_t>(n)};
      kernels.measure({.width = width,
                       .n_rows = n_rows,
                       .is_light = is_light,
                       .grey = grey.data(),
                       .column_sum = out.column.data(),
                       .min_grey = out.min_grey.data(),
                       .max_grey = out.max_grey.data(),
                       .sum = out.sum.data()});
      const int by = 1 + width % 5;
      if (width > by) kernels.widen(out.wide.data(), width - by, by);
      kernels.add(out.added.data(), min_grey.data(), width);
      kernels.add_grey(out.levels.data(), grey.data(), width);
      std::vector<int32_t> high = corners[0], signed_max = max_grey, signed_min = min_grey;
      for (size_t i = 0; i < n; ++i) {
        high[i] += insides[i];
        if (is_light) signed_max[i] *= -1;
        if (is_light) signed_min[i] *= -1;
      }
      kernels.bound({.n_tiles = width,
                     .is_light = is_light,
                     .threshold_q15 = is_light ? 62'259 : 3'932,
                     .area = 69 * 69,
                     .inverse_q32 = 902'106,
                     .n_rows = 56,
                     .n_columns = columns.data(),
                     .high_right = high.data(),
                     .high_left = corners[0].data(),
                     .low_right = corners[1].data(),
                     .low_left = corners[1].data(),
                     .min_grey = signed_min.data(),
                     .max_grey_in_boxes = signed_max.data(),
                     .open = out.open.data()});
      return out;
    };
    for (const bool is_light : {false, true}) {
      const Tiles reference = run(kScalar.dots.tiles, is_light);
      for (size_t tile = 0; tile < static_cast<size_t>(n_tiles); ++tile) {
        EXPECT_LE(reference.min_grey[tile], reference.max_grey[tile]);
      }
      for (const Version& version : versions()) {
        EXPECT_EQ(run(version.kernels->dots.tiles, is_light), reference) << version.name << ", width " << width;
      }
    }
  }
}

TEST(Kernels, SumsOfADotAreTheSameAtAnySizeAndAtTheLimits) {
  std::mt19937 random(16);  // NOLINT: the same numbers on every run
  for (int radius = 2; radius <= DotWindow::kMaxRadiusPx; ++radius) {
    for (int turn = 0; turn < 6; ++turn) {
      const int side = 2 * radius + 2;
      const auto n = static_cast<size_t>(((side - 1) * side + 15) / 16 * 16);
      const auto stride = static_cast<size_t>(3 * (side + turn));
      const bool is_extreme = turn == 0;
      // Not a byte more than the window has.
      std::vector<uint8_t> pixels(stride * static_cast<size_t>(side - 1) + static_cast<size_t>(3 * side), 255);
      std::vector<int16_t> h_x(n), h_y(n), t(n), keep(n);
      const auto drawn = [&](int limit) {
        return static_cast<int16_t>(
            is_extreme ? limit : static_cast<int>(random() % (2U * static_cast<unsigned>(limit))) - limit);
      };
      for (uint8_t& level : pixels) level = is_extreme ? 255 : static_cast<uint8_t>(random());
      for (int y = 0; y < side - 1; ++y) {
        for (int x = 0; x < side - 1; ++x) {
          const auto i = static_cast<size_t>(y * side + x);
          if (!is_extreme && random() % 4 == 0) continue;
          h_x[i] = drawn(2'047);
          h_y[i] = drawn(2'047);
          t[i] = drawn(4'080);
          keep[i] = -1;
        }
      }
      std::vector<int16_t> luma(n + static_cast<size_t>(side) + 1);
      const auto run = [&](const Kernels& kernels) {
        return kernels.dot_sums({.pixels = pixels.data(),
                                 .stride = static_cast<ptrdiff_t>(stride),
                                 .side = side,
                                 .share_x = static_cast<int16_t>(is_extreme ? 32'767 : 5'000 + 3'000 * turn),
                                 .share_y = static_cast<int16_t>(7'000 * turn % 32'768),
                                 .n_values = static_cast<int>(n),
                                 .h_x = h_x.data(),
                                 .h_y = h_y.data(),
                                 .t = t.data(),
                                 .keep = keep.data(),
                                 .luma = luma.data()});
      };
      const DotSums reference = run(kScalar);
      const auto n_kept = std::count(keep.begin(), keep.end(), int16_t{-1});
      if (is_extreme) {
        EXPECT_EQ(reference.sum, 4'080 * n_kept);
        EXPECT_EQ(reference.common, int64_t{4'080} * 4'080 * n_kept);
      }
      for (const Version& version : versions())
        EXPECT_EQ(run(*version.kernels), reference) << version.name << " " << radius;
    }
  }
}

struct Cells {
  std::vector<CellSlope> slope;
  std::vector<int16_t> n_kept;
};

TEST(Kernels, CellsAreTheSameAtAnyStepAndCount) {
  std::mt19937 random(13);  // NOLINT: the same numbers on every run
  const auto any = [&] { return static_cast<int16_t>(random() % 65'536 - 32'768); };
  std::vector<int32_t> table(Photometric::kSlopeSize * Photometric::kSlopeSize);
  for (int32_t& t : table) t = static_cast<int32_t>(random());
  std::vector<int32_t> bend(Photometric::kBendSize * Photometric::kBendSize * Photometric::kBendSize);
  for (int32_t& t : bend) t = static_cast<int32_t>(random());
  std::array<std::array<int32_t, 17>, 3> per_count{};
  for (size_t n = 1; n <= 16; ++n) {
    for (size_t c = 0; c < 3; ++c) per_count[c][n] = static_cast<int32_t>((3 + c) * (1 << 18) / n);
  }
  for (int step = 1; step <= 4; ++step) {
    for (int n_cells = 1; n_cells < 30; ++n_cells) {
      const int width = n_cells * step + static_cast<int>(random() % 4) % step;
      const auto n_pixels = static_cast<size_t>(width * step);
      const bool is_extreme = n_cells % 3 == 0;
      std::vector<int16_t> change(3 * n_pixels);
      for (int16_t& d : change) d = is_extreme ? int16_t{-32'768} : any();
      std::vector<int16_t> keep(n_pixels);
      for (int16_t& k : keep) k = is_extreme || random() % 3 != 0 ? int16_t{-1} : int16_t{0};
      std::vector<int16_t> unmix(6 * static_cast<size_t>(n_cells));
      for (int16_t& m : unmix) m = is_extreme ? int16_t{-32'768} : static_cast<int16_t>(any() >> (n_cells % 4));
      const auto run = [&](const Kernels& kernels) {
        Cells out{std::vector<CellSlope>(static_cast<size_t>(n_cells)),
                  std::vector<int16_t>(static_cast<size_t>(n_cells))};
        kernels.cells({.step_px = step,
                       .n_cells = n_cells,
                       .width = width,
                       .plane = static_cast<ptrdiff_t>(n_pixels),
                       .change = change.data(),
                       .keep = keep.data(),
                       .unmix_plane = n_cells,
                       .unmix = unmix.data(),
                       .slope = table.data(),
                       .bend = n_cells % 2 == 0 ? bend.data() : nullptr,
                       .bend_low_q16 = {-40'000, -65'536, 3},
                       .bend_shift = {6, 4, 1},
                       .per_count = per_count.data(),
                       .level_q16 = {-21'845, 13'107, 77},
                       .out = out.slope.data(),
                       .n_kept = out.n_kept.data()});
        return out;
      };
      const Cells reference = run(kScalar);
      for (const Version& version : versions()) {
        const Cells other = run(*version.kernels);
        EXPECT_EQ(other.n_kept, reference.n_kept) << version.name << ", step " << step << ", " << n_cells << " cells";
        for (size_t i = 0; i < reference.slope.size(); ++i) {
          ASSERT_EQ(other.slope[i].x, reference.slope[i].x) << version.name << ", step " << step << ", cell " << i;
          ASSERT_EQ(other.slope[i].y, reference.slope[i].y) << version.name << ", step " << step << ", cell " << i;
        }
      }
    }
  }
}

}  // namespace
}  // namespace ruffini::kernels
