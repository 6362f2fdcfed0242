#include "solve/block_kernel.h"

#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

namespace ruffini::block_kernel {
namespace {

struct Kernel {
  std::string name;
  Row row;
};

std::vector<Kernel> kernels() {
  std::vector<Kernel> out = {{"neon", row_neon}};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) out.push_back({"avx2", row_avx2});
#endif
  return out;
}

// sum over blocks of (q . u) << shift, one product after the other.
int64_t by_hand(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks) {
  int64_t sum = 0;
  for (const uint16_t b : blocks) {
    for (size_t j = size_t{b} * kBlock; j < (size_t{b} + 1) * kBlock; ++j) {
      sum += (int64_t{q[j]} * u[j]) * (int64_t{1} << shift[b]);
    }
  }
  return sum;
}

TEST(BlockKernel, AllVersionsAreEqualAtAnySizeAndAlignment) {
  std::mt19937 random(7);  // NOLINT: the same numbers on every run
  for (int round = 0; round < 300; ++round) {
    const size_t n_blocks = 1 + random() % 40;
    const size_t offset = random() % 16;  // 2-byte steps off any vector's alignment
    const bool is_extreme = round % 5 == 0;
    std::vector<int16_t> q(n_blocks * kBlock + offset);
    std::vector<int16_t> u(n_blocks * kBlock + offset);
    for (int16_t& v : q)
      v = static_cast<int16_t>(is_extreme ? (random() % 2 ? 16'383 : -16'383)
                                          : static_cast<int>(random() % 32'767) - 16'383);
    for (int16_t& v : u)
      v = static_cast<int16_t>(is_extreme ? (random() % 4 ? -32'768 : 32'767)
                                          : static_cast<int>(random() % 65'536) - 32'768);
    std::vector<uint8_t> shift(n_blocks);
    for (uint8_t& s : shift) s = static_cast<uint8_t>(random() % 23);
    std::vector<uint16_t> blocks;
    for (uint16_t b = 0; b < n_blocks; ++b) {
      if (random() % 3 != 0) blocks.push_back(b);
    }
    const int64_t expected = by_hand(q.data() + offset, shift.data(), u.data() + offset, blocks);
    EXPECT_EQ(row_scalar(q.data() + offset, shift.data(), u.data() + offset, blocks), expected);
    for (const Kernel& kernel : kernels()) {
      EXPECT_EQ(kernel.row(q.data() + offset, shift.data(), u.data() + offset, blocks), expected) << kernel.name;
    }
  }
}

TEST(BlockKernel, NoBlocksIsZero) { EXPECT_EQ(best()(nullptr, nullptr, nullptr, {}), 0); }

}  // namespace
}  // namespace ruffini::block_kernel
