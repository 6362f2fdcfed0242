#include "solve/block_kernel.h"

#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

namespace ruffini::block_kernel {
namespace {

struct Kernel {
  std::string name;
  Rows rows;
};

std::vector<Kernel> kernels() {
  std::vector<Kernel> out = {{"scalar", rows_scalar}, {"neon", rows_neon}};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) out.push_back({"avx2", rows_avx2});
#endif
  return out;
}

// sum over blocks of (q . u) << shift of one row, one product after the other.
int64_t by_hand(size_t n_rows, size_t row, Table table, const int16_t* u, std::span<const uint16_t> blocks) {
  int64_t sum = 0;
  for (const uint16_t b : blocks) {
    for (size_t j = 0; j < kBlock; ++j) {
      const size_t at = b * n_rows + row;
      sum += (int64_t{table.q[at * kBlock + j]} * u[size_t{b} * kBlock + j]) * (int64_t{1} << table.shift[at]);
    }
  }
  return sum;
}

TEST(BlockKernel, AllVersionsAreEqualAtAnySizeAndAlignment) {
  std::mt19937 random(7);  // NOLINT: the same numbers on every run
  for (int round = 0; round < 400; ++round) {
    const size_t n_rows = 1 + random() % kRows;
    const size_t n_blocks = 1 + random() % 40;
    const size_t offset = random() % 16;  // 2-byte steps off any vector's alignment
    const bool is_extreme = round % 5 == 0;
    std::vector<int16_t> q(n_rows * n_blocks * kBlock + offset);
    std::vector<int16_t> u(n_blocks * kBlock + offset);
    for (int16_t& v : q)
      v = static_cast<int16_t>(is_extreme ? (random() % 2 ? 16'383 : -16'383)
                                          : static_cast<int>(random() % 32'767) - 16'383);
    for (int16_t& v : u)
      v = static_cast<int16_t>(is_extreme ? (random() % 4 ? -32'768 : 32'767)
                                          : static_cast<int>(random() % 65'536) - 32'768);
    std::vector<uint8_t> shift(n_rows * n_blocks);
    for (uint8_t& s : shift) s = static_cast<uint8_t>(random() % 23);
    std::vector<uint16_t> blocks;
    for (uint16_t b = 0; b < n_blocks; ++b) {
      if (random() % 3 != 0) blocks.push_back(b);
    }
    const Table table{q.data() + offset, shift.data()};
    for (const Kernel& kernel : kernels()) {
      std::vector<int64_t> out(n_rows, -1);
      kernel.rows(static_cast<int>(n_rows), table, u.data() + offset, blocks, out.data());
      for (size_t r = 0; r < n_rows; ++r) {
        EXPECT_EQ(out[r], by_hand(n_rows, r, table, u.data() + offset, blocks)) << kernel.name << " row " << r;
      }
    }
  }
}

TEST(BlockKernel, NoBlocksIsZero) {
  std::vector<int64_t> out(kRows, 5);
  fastest_supported()(kRows, {}, nullptr, {}, out.data());
  EXPECT_EQ(out, std::vector<int64_t>(kRows, 0));
}

}  // namespace
}  // namespace ruffini::block_kernel
