#include "solve/block_operator.h"

#include <algorithm>
#include <array>

#include "base/fixed.h"

namespace ruffini {

Result<BlockOperator> BlockOperator::load(const Calibration& calibration, const std::string& name, int n_rows,
                                          int n_cols) {
  BlockOperator out;
  out.n_rows_ = n_rows;
  out.n_blocks_ = (n_cols + kBlock - 1) / kBlock;
  auto entry = calibration.tensor(name + ".entry", Tensor::Type::kI16, {n_rows, out.padded_cols()});
  if (!entry) return entry.error();
  auto shift = calibration.tensor(name + ".shift", Tensor::Type::kU8, {n_rows, out.n_blocks_});
  if (!shift) return shift.error();
  auto out_shift = calibration.integer(name + ".out_shift", 1, 60);
  if (!out_shift) return out_shift.error();
  out.entry_ = entry.value()->as<int16_t>();
  out.shift_ = shift.value()->as<uint8_t>();
  out.out_shift_ = static_cast<int>(out_shift.value());
  const Error overflow{ErrorKind::kBadInput,
                       "calibration file: " + name + " could overflow an accumulator: compile the operator again"};
  for (const int16_t q : out.entry_) {
    if (q < -kMaxEntry || q > kMaxEntry) return overflow;
  }
  for (int r = 0; r < n_rows; ++r) {
    uint64_t bound = 0;
    for (int b = 0; b < out.n_blocks_; ++b) {
      const int s = out.shift_[static_cast<size_t>(r * out.n_blocks_ + b)];
      if (s > 27) return overflow;
      bound += uint64_t{1} << (34 + s);
      if (bound > uint64_t{1} << 62) return overflow;
    }
  }
  return out;
}

int64_t BlockOperator::block_sum(int r, int block, const int16_t* u) const {
  const int16_t* q =
      entry_.data() + static_cast<size_t>(r) * static_cast<size_t>(padded_cols()) + static_cast<size_t>(block) * kBlock;
  const int16_t* v = u + static_cast<size_t>(block) * kBlock;
  // Eight lanes of four products: |lane| <= 4 x 16383 x 32768 < 2^31. Compilers make vectors of this form.
  constexpr size_t n = kBlock / 4;
  std::array<int32_t, n> lanes;
  for (size_t i = 0; i < n; ++i) {
    lanes[i] = q[i] * v[i] + q[i + n] * v[i + n] + q[i + 2 * n] * v[i + 2 * n] + q[i + 3 * n] * v[i + 3 * n];
  }
  int64_t sum = 0;
  for (const int32_t lane : lanes) sum += lane;
  return sum << shift_[static_cast<size_t>(r * n_blocks_ + block)];
}

int64_t BlockOperator::row(int r, std::span<const int16_t> u) const {
  int64_t sum = 0;
  for (int b = 0; b < n_blocks_; ++b) sum += block_sum(r, b, u.data());
  return round_shift(sum, out_shift_);
}

int64_t BlockOperator::row(int r, std::span<const int16_t> u, std::span<const uint16_t> blocks) const {
  int64_t sum = 0;
  for (const uint16_t b : blocks) sum += block_sum(r, b, u.data());
  return round_shift(sum, out_shift_);
}

}  // namespace ruffini
