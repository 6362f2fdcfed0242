#include "image/cosine_transform.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "image/lanes_scalar.h"

namespace ruffini {
namespace {

constexpr int kLengths[] = {1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 31, 80, 120, 160, 240, 320, 631, 640};

std::vector<int32_t> some_numbers(int n) {
  std::vector<int32_t> out(static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) out[static_cast<size_t>(i)] = (i * 7919 % 2003 - 1000) * 400;
  return out;
}

double cosine(int k, int i, int n) { return std::cos(std::numbers::pi * k * (2 * i + 1) / (2 * n)); }

// Each rounding is half a step at most; the transform adds up as many as there are inputs.
double tolerance(int n) { return 1 + std::sqrt(n); }

TEST(CosineTransform, ForwardIsTheSumOfCosinesForEvenOddAndPrimeLengths) {
  for (const int n : kLengths) {
    const CosineTables tables(n);
    const std::vector<int32_t> in = some_numbers(n);
    std::vector<int32_t> out(in.size());
    std::vector<int32_t> work(3 * in.size());
    CosineTransform<ScalarLanes>(tables).forward(in.data(), out.data(), work.data());
    for (int k = 0; k < n; ++k) {
      double expected = 0;
      for (int i = 0; i < n; ++i) expected += in[static_cast<size_t>(i)] * cosine(k, i, n);
      EXPECT_NEAR(out[static_cast<size_t>(k)], expected, tolerance(n)) << "wave " << k << " of " << n;
    }
  }
}

TEST(CosineTransform, InverseIsTheTransposedSum) {
  for (const int n : kLengths) {
    const CosineTables tables(n);
    const std::vector<int32_t> in = some_numbers(n);
    std::vector<int32_t> out(in.size());
    std::vector<int32_t> work(3 * in.size());
    CosineTransform<ScalarLanes>(tables).inverse(in.data(), out.data(), work.data());
    for (int i = 0; i < n; ++i) {
      double expected = 0;
      for (int k = 0; k < n; ++k) expected += in[static_cast<size_t>(k)] * cosine(k, i, n);
      EXPECT_NEAR(out[static_cast<size_t>(i)], expected, tolerance(n)) << "place " << i << " of " << n;
    }
  }
}

// The bound of the header, at its worst: all inputs of one sign, or alternating, as large as they may be.
TEST(CosineTransform, TheLargestInputsDoNotOverflow) {
  for (const int n : kLengths) {
    const CosineTables tables(n);
    const int32_t largest = (1 << 30) / n - 1;
    for (int period = 1; period <= 4; ++period) {
      std::vector<int32_t> in(static_cast<size_t>(n));
      for (int i = 0; i < n; ++i) in[static_cast<size_t>(i)] = i / period % 2 == 0 || period == 4 ? largest : -largest;
      std::vector<int32_t> out(in.size());
      std::vector<int32_t> work(3 * in.size());
      CosineTransform<ScalarLanes>(tables).forward(in.data(), out.data(), work.data());
      for (int k = 0; k < n; ++k) {
        double expected = 0;
        for (int i = 0; i < n; ++i) expected += in[static_cast<size_t>(i)] * cosine(k, i, n);
        ASSERT_NEAR(out[static_cast<size_t>(k)], expected, tolerance(n)) << "wave " << k << " of " << n;
      }
      CosineTransform<ScalarLanes>(tables).inverse(in.data(), out.data(), work.data());
      for (int i = 0; i < n; ++i) {
        double expected = 0;
        for (int k = 0; k < n; ++k) expected += in[static_cast<size_t>(k)] * cosine(k, i, n);
        ASSERT_NEAR(out[static_cast<size_t>(i)], expected, tolerance(n)) << "place " << i << " of " << n;
      }
    }
  }
}

}  // namespace
}  // namespace ruffini
