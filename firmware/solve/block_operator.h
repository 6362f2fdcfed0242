// A dense integer matrix in blocks of 32 columns with one power-of-two scale each (proto/CALIBRATION.md).
//
//   out[r] = (sum over blocks b of ((sum over j in b of q[r, j] u[j]) << s[r, b]) + half) >> out_shift
//
// Bounds: |q| <= 16383 and int16 u give four products per int32 lane and |block sum| < 2^34; the loader
// proves sum over b of 2^(34 + s[r, b]) <= 2^62, so no accumulator can overflow.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"
#include "solve/block_kernel.h"
#include "store/calibration.h"

namespace ruffini {

class BlockOperator {
 public:
  static constexpr int kBlock = block_kernel::kBlock;
  static constexpr int kMaxEntry = 16'383;

  BlockOperator() = default;

  // Tensors `<name>.entry`, `<name>.shift` and the integer `<name>.out_shift`; proves the bounds.
  [[nodiscard]] static Result<BlockOperator> load(const Calibration& calibration, const std::string& name, int n_rows,
                                                  int n_cols);

  [[nodiscard]] int n_rows() const { return n_rows_; }
  [[nodiscard]] int n_blocks() const { return n_blocks_; }
  [[nodiscard]] int padded_cols() const { return n_blocks_ * kBlock; }

  // One row times u (padded_cols() values, zero padded), all blocks.
  [[nodiscard]] int64_t row(int r, std::span<const int16_t> u) const;
  // The same over some blocks only: those where u is not zero.
  [[nodiscard]] int64_t row(int r, std::span<const int16_t> u, std::span<const uint16_t> blocks) const;

 private:
  std::span<const int16_t> entry_;
  std::span<const uint8_t> shift_;
  std::vector<uint16_t> all_blocks_;
  block_kernel::Row kernel_ = block_kernel::row_scalar;
  int n_rows_ = 0;
  int n_blocks_ = 0;
  int out_shift_ = 1;
};

}  // namespace ruffini
