#include "image/flow_kernel.h"

#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

namespace ruffini::flow_kernel {
namespace {

struct Named {
  std::string name;
  const Version* version;
};

std::vector<Named> others() {
  std::vector<Named> out = {{"neon", &kNeon}};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) out.push_back({"avx2", &kAvx2});
#endif
  return out;
}

TEST(FlowKernel, AllVersionsAreEqualAtAnyPlaceAndStride) {
  std::mt19937 random(11);  // NOLINT: the same numbers on every run
  const auto within = [&](int low, int high) {
    return low + static_cast<int>(random() % static_cast<unsigned>(high - low + 1));
  };
  for (int round = 0; round < 500; ++round) {
    const bool is_extreme = round % 5 == 0;
    const int stride = within(9, 40);
    const int row_step = within(1, 2);
    const int offset = within(0, 15);  // 2-byte steps off any vector's alignment
    std::vector<int16_t> picture(static_cast<size_t>(stride * (7 * row_step + 2) + offset));
    for (int16_t& v : picture) v = static_cast<int16_t>(is_extreme ? 4080 * within(0, 1) : within(0, 4080));
    std::vector<int16_t> h(2 * kArea);
    for (int16_t& v : h) v = static_cast<int16_t>(is_extreme ? 2047 * (2 * within(0, 1) - 1) : within(-2047, 2047));
    std::vector<int16_t> t(kArea);
    for (int16_t& v : t) v = static_cast<int16_t>(is_extreme ? 4080 * (2 * within(0, 1) - 1) : within(-4080, 4080));
    const Block block{picture.data() + offset, stride, ptrdiff_t{stride} * row_step,
                      static_cast<int16_t>(is_extreme ? 32'767 : within(0, 32'767)),
                      static_cast<int16_t>(is_extreme ? 32'767 : within(0, 32'767))};
    const GradientSums gradient = kScalar.gradient(block, h.data());
    const CorrelationSums correlation = kScalar.correlation(block, t.data());
    std::vector<int16_t> value(t);
    for (int16_t& v : value) v = static_cast<int16_t>(v < 0 ? -v : v);
    const MisfitSums misfit = kScalar.misfit(block.at, stride, value.data());
    for (const Named& other : others()) {
      const GradientSums g = other.version->gradient(block, h.data());
      EXPECT_EQ(g.x, gradient.x) << other.name;
      EXPECT_EQ(g.y, gradient.y) << other.name;
      const CorrelationSums l = other.version->correlation(block, t.data());
      EXPECT_EQ(l.value, correlation.value) << other.name;
      EXPECT_EQ(l.square, correlation.square) << other.name;
      EXPECT_EQ(l.product, correlation.product) << other.name;
      const MisfitSums m = other.version->misfit(block.at, stride, value.data());
      EXPECT_EQ(m.square, misfit.square) << other.name;
      EXPECT_EQ(m.value, misfit.value) << other.name;
    }
  }
}

TEST(FlowKernel, SamplesLieBetweenThePixels) {
  std::vector<int16_t> picture(16 * 16);
  for (size_t i = 0; i < picture.size(); ++i) picture[i] = static_cast<int16_t>(16 * (i % 16) + 32 * (i / 16));
  const std::vector<int16_t> one(2 * kArea, 1);
  // A plane: 64 times its value in the middle of the 8 x 8 places, moved by a half and a quarter pixel.
  const Block block{picture.data(), 16, 16, 1 << 14, 1 << 13};
  EXPECT_EQ(kScalar.gradient(block, one.data()).x, 64 * (16 * 35 + 32 * 35) / 10 + 64 * (8 + 8));
}

}  // namespace
}  // namespace ruffini::flow_kernel
