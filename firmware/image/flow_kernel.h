// Inner loops of the texture flow: blocks of 8 x 8 samples, int16 of 12 bits (Q4 grey levels).
//
// A sample between four pixels a b / c d:  upper = a + r(b - a, fx), lower = c + r(d - c, fx), upper + r(lower - upper,
// fy) with r(v, f) = (v f + 2^14) >> 15, as NEON's VQRDMULH. Samples are within 0..4080, gradients within +-2047, so
// that a sum of 64 products fits int32. Integer sums do not depend on their order, so all versions are bit-identical.
#pragma once

#include <cstddef>
#include <cstdint>

namespace ruffini::flow_kernel {

inline constexpr int kSide = 8;
inline constexpr int kArea = kSide * kSide;
inline constexpr int kMaxGradient = 2047;

// Position of a block in a picture. It reads 9 pixels of 9 rows, or of 8 pairs of rows.
struct Block {
  const int16_t* at = nullptr;
  ptrdiff_t stride = 0;    // from one row of pixels to the next
  ptrdiff_t row_step = 0;  // from one row of samples to the next
  int16_t x_q15 = 0;
  int16_t y_q15 = 0;
};

struct GradientSums {
  int32_t x = 0;  // sum of h_x times the samples
  int32_t y = 0;
};

struct CorrelationSums {
  int32_t value = 0;  // sum of the samples
  int32_t square = 0;
  int32_t product = 0;  // sum of the products with the template
};

struct MisfitSums {
  int64_t square = 0;  // sum of (picture - template)^2
  int32_t value = 0;
};

struct Version {
  // h: h_x of the 64 samples, then h_y.
  GradientSums (*gradient)(const Block& block, const int16_t* h);
  CorrelationSums (*correlation)(const Block& block, const int16_t* t);
  // Compares a block of 8 rows at whole pixels with 64 template values.
  MisfitSums (*misfit)(const int16_t* at, ptrdiff_t stride, const int16_t* value);
};

extern const Version kScalar;  // the reference
// Compiled for targets that have these instructions, and by SIMDe in tests.
extern const Version kAvx2;
extern const Version kNeon;

// Returns the fastest version that this processor supports.
const Version& fastest_supported();

}  // namespace ruffini::flow_kernel
