#include "solve/block_operator.h"

#include <numeric>

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
  out.kernel_ = block_kernel::best();
  out.all_blocks_.resize(static_cast<size_t>(out.n_blocks_));
  std::iota(out.all_blocks_.begin(), out.all_blocks_.end(), uint16_t{0});
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

int64_t BlockOperator::row(int r, std::span<const int16_t> u) const { return row(r, u, all_blocks_); }

int64_t BlockOperator::row(int r, std::span<const int16_t> u, std::span<const uint16_t> blocks) const {
  const auto at = static_cast<size_t>(r) * static_cast<size_t>(n_blocks_);
  return round_shift(kernel_(entry_.data() + at * kBlock, shift_.data() + at, u.data(), blocks), out_shift_);
}

}  // namespace ruffini
