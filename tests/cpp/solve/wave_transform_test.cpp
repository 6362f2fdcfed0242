#include "solve/wave_transform.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace ruffini {
namespace {

constexpr int kOne = 1 << WaveTransform::kFraction;

// Cosines on n places, mirrored at the first and the last one.
WaveTable cosines(int n_waves, int n_places) {
  std::vector<int16_t> entries;
  for (int w = 0; w < n_waves; ++w) {
    for (int p = 0; p < n_places; ++p) {
      entries.push_back(static_cast<int16_t>(std::lround(kOne * std::cos(std::numbers::pi * w * p / (n_places - 1)))));
    }
  }
  return {entries, n_waves, n_places};
}

TEST(NarrowTo14, KeepsWhatFitsAndRoundsHalfUp) {
  std::vector<int16_t> out(3);
  EXPECT_EQ(narrow_to_14(std::vector<int32_t>{16382, -5, 0}, out), 0);
  EXPECT_EQ(out, (std::vector<int16_t>{16382, -5, 0}));
  EXPECT_EQ(narrow_to_14(std::vector<int32_t>{40000, -6, -2}, out), 2);
  EXPECT_EQ(out, (std::vector<int16_t>{10000, -1, 0}));
  EXPECT_EQ(narrow_to_14(std::vector<int32_t>{INT32_MAX, INT32_MIN + 1, 0}, out), 18);
  EXPECT_EQ(out, (std::vector<int16_t>{8192, -8192, 0}));
}

TEST(WaveTransform, AWaveIsThatWaveAgain) {
  const WaveTable x = cosines(5, 23);
  const WaveTable y = cosines(4, 7);  // fewer places than the fast product takes at once
  for (const auto& [along_y, along_x] : {std::pair{&y, &x}, std::pair{&x, &y}}) {
    WaveTransform transform(std::vector<WaveTransform::Kind>{{along_y, along_x}});
    std::vector<int16_t> one(static_cast<size_t>(along_y->n_waves * along_x->n_waves));
    one[static_cast<size_t>(2 * along_x->n_waves + 3)] = 10000;
    std::vector<int32_t> field(static_cast<size_t>(along_y->n_places * along_x->n_places));
    const double scale = std::exp2(transform.to_places(one, field));
    for (int j = 0; j < along_y->n_places; ++j) {
      for (int i = 0; i < along_x->n_places; ++i) {
        const double wave = std::cos(std::numbers::pi * 2 * j / (along_y->n_places - 1)) *
                            std::cos(std::numbers::pi * 3 * i / (along_x->n_places - 1));
        EXPECT_NEAR(field[static_cast<size_t>(j * along_x->n_places + i)] * scale, 10000 * wave, 10);
      }
    }
    // The mirrors' places count half: then waves of cosines do not mix.
    for (int j = 0; j < along_y->n_places; ++j) {
      for (int i = 0; i < along_x->n_places; ++i) {
        int32_t& f = field[static_cast<size_t>(j * along_x->n_places + i)];
        if (j == 0 || j == along_y->n_places - 1) f /= 2;
        if (i == 0 || i == along_x->n_places - 1) f /= 2;
      }
    }
    std::vector<int16_t> waves(one.size());
    const double back = std::exp2(transform.to_waves(field, waves)) * scale;
    const double expected = 10000.0 * (along_y->n_places - 1) * (along_x->n_places - 1) / 4;
    for (size_t i = 0; i < one.size(); ++i) EXPECT_NEAR(waves[i] * back, one[i] == 0 ? 0 : expected, 0.002 * expected);
  }
}

}  // namespace
}  // namespace ruffini
