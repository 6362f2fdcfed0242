#include "solve/block_program.h"

#include <algorithm>
#include <array>

#include "solve/block_float.h"

namespace ruffini {
namespace {

constexpr size_t kBlock = block_kernel::kBlock;

// Sums the signed values that one row of a fold refers to; values[0] is zero. Branch-free, because the signs are
// unpredictable.
int64_t signed_sum(std::span<const int32_t> row, std::span<const int64_t> values) {
  int64_t sum = 0;
  for (const int32_t i : row) {
    const int32_t negative = i >> 31;  // all bits set, or none
    sum += (values[static_cast<size_t>((i ^ negative) - negative)] ^ negative) - negative;
  }
  return sum;
}

}  // namespace

void BlockProgram::select(std::span<const uint32_t> outputs) {
  selected_.assign(outputs.begin(), outputs.end());
  std::fill(wanted_.begin(), wanted_.end(), uint8_t{0});
  for (const uint32_t output : outputs) {
    for (const int32_t i : out_.subspan(output * n_unfold_, n_unfold_)) {
      if (i != 0) wanted_[static_cast<size_t>(i < 0 ? -i : i) - 1] = 1;
    }
  }
}

void BlockProgram::run(std::span<const int16_t> u, std::span<int64_t> out) {
  fold(u);
  for (size_t s = 0; s < stage_.size(); ++s) {
    const Stage& stage = stage_[s];
    const bool is_last = s + 1 == stage_.size();
    std::fill_n(sum_.begin() + 1, stage.n_values, int64_t{0});
    for (uint32_t p = 0; p < stage.n_panels; ++p) multiply(panel_[stage.first_panel + p], is_last);
    if (!is_last) {
      for (size_t i = 1; i <= stage.n_values; ++i) sum_[i] = block_float::to_16(sum_[i], stage.shift);
      store_vector(s + 1, stage.n_values);
    }
  }
  for (const uint32_t r : selected_) {
    out[r] = round_shift(signed_sum(out_.subspan(r * n_unfold_, n_unfold_), sum_), out_shift_);
  }
}

void BlockProgram::fold(std::span<const int16_t> u) {
  const size_t n = vector_[0].size();
  std::copy_n(u.begin(), n_in_, input_.begin() + 1);
  for (size_t i = 0; i < n; ++i) sum_[i + 1] = signed_sum(in_.subspan(i * n_fold_, n_fold_), input_);
  store_vector(0, n);
}

void BlockProgram::store_vector(size_t index, size_t n_values) {
  const std::span<const int64_t> values(sum_.data() + 1, n_values);
  const int shift = block_float::common_shift(values);
  std::vector<int16_t>& out = vector_[index];
  for (size_t i = 0; i < n_values; ++i) out[i] = static_cast<int16_t>(block_float::to_16(values[i], shift));
  exponent_[index] = shift;
}

// Gathers the panel's part of its source vector, zero padded, and lists the blocks that are not all zero.
void BlockProgram::gather(const Panel& panel) {
  const std::vector<int16_t>& source = vector_[panel.source];
  size_t n = 0;
  for (uint32_t k = 0; k < panel.n_segments; ++k) {
    const Segment& segment = segment_[panel.first_segment + k];
    std::copy_n(source.begin() + segment.first, segment.count, gathered_.begin() + static_cast<ptrdiff_t>(n));
    n += segment.count;
  }
  std::fill(gathered_.begin() + static_cast<ptrdiff_t>(n),
            gathered_.begin() + static_cast<ptrdiff_t>(panel.n_blocks * kBlock), int16_t{0});
  blocks_.clear();
  for (size_t b = 0; b < panel.n_blocks; ++b) {
    int any = 0;
    for (size_t j = b * kBlock; j < (b + 1) * kBlock; ++j) any |= gathered_[j];
    if (any != 0) blocks_.push_back(static_cast<uint16_t>(b));
  }
}

void BlockProgram::multiply(const Panel& panel, bool is_last) {
  gather(panel);
  if (blocks_.empty()) return;
  const int64_t scale = int64_t{1} << exponent_[panel.source];
  std::array<int64_t, block_kernel::kRows> sums;
  for (uint32_t r = 0; r < panel.n_rows; r += block_kernel::kRows) {
    const uint32_t n = std::min<uint32_t>(panel.n_rows - r, block_kernel::kRows);
    const size_t row = panel.first_row + r;
    if (is_last && std::all_of(&wanted_[row], &wanted_[row] + n, [](uint8_t w) { return w == 0; })) continue;
    const size_t at = panel.at + size_t{r} * panel.n_blocks;
    kernel_(static_cast<int>(n), {&entry_[at * kBlock], &shift_[at]}, gathered_.data(), blocks_, sums.data());
    for (uint32_t i = 0; i < n; ++i) sum_[1 + row + i] += sums[i] * scale;
  }
}

}  // namespace ruffini
