#include "image/kernels.h"

#include <gtest/gtest.h>

#include <random>
#include <string>

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
  if (__builtin_cpu_supports("avx2")) out.push_back({"avx2", &kAvx2});
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

}  // namespace
}  // namespace ruffini::kernels
