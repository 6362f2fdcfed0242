#include "solve/block_program.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "solve/block_float.h"

namespace ruffini {
namespace {

constexpr size_t kBlock = block_kernel::kBlock;
constexpr uint32_t kRows = block_kernel::kRows;

// (v + half) >> shift of to_16(), without its branch.
struct Rounding {
  int shift;
  int64_t half;

  explicit Rounding(int by) : shift(by), half(by == 0 ? 0 : int64_t{1} << (by - 1)) {}
  [[nodiscard]] int64_t operator()(int64_t v) const { return (v + half) >> shift; }
};

// Sums the signed values that one row of a fold refers to; values[0] is zero. Branch-free, because the signs are
// unpredictable.
template <size_t kFold>
int64_t signed_sum(const int32_t* row, const int64_t* values) {
  int64_t sum = 0;
  for (size_t k = 0; k < kFold; ++k) {
    const int64_t negative = row[k] >> 31;  // all bits set, or none
    sum += (values[(row[k] ^ negative) - negative] ^ negative) - negative;
  }
  return sum;
}

bool are_eight_zero(const uint8_t* flags) {
  uint64_t eight;
  std::memcpy(&eight, flags, sizeof eight);
  return eight == 0;
}

// Lists the runs of ones in `flags`.
template <typename Segment>
void list_ranges(std::span<const uint8_t> flags, std::vector<Segment>& ranges) {
  ranges.clear();
  const auto n = static_cast<uint32_t>(flags.size());
  uint32_t i = 0;
  while (i < n) {
    if (i + 8 <= n && are_eight_zero(&flags[i])) {
      i += 8;
      continue;
    }
    if (flags[i] == 0) {
      ++i;
      continue;
    }
    const uint32_t first = i;
    while (i < n && flags[i] != 0) ++i;
    ranges.push_back({first, i - first});
  }
}

// Calls `work` with the number of terms as a constant.
template <typename Work>
void with_fold(size_t n, Work work) {
  switch (n) {
    case 0:
      return work(std::integral_constant<size_t, 0>{});
    case 1:
      return work(std::integral_constant<size_t, 1>{});
    case 2:
      return work(std::integral_constant<size_t, 2>{});
    case 3:
      return work(std::integral_constant<size_t, 3>{});
    default:
      return work(std::integral_constant<size_t, 4>{});
  }
}

}  // namespace

void BlockProgram::select(std::span<const uint32_t> outputs) {
  want(outputs);
  if (!reads_all_) {
    read_all();
    plan();
  }
  plan_last_groups();
}

void BlockProgram::select(std::span<const uint32_t> outputs, std::span<const uint32_t> inputs) {
  want(outputs);
  read(inputs);
  plan();
  plan_last_groups();
}

void BlockProgram::want(std::span<const uint32_t> outputs) {
  selected_.assign(outputs.begin(), outputs.end());
  std::fill(wanted_.begin(), wanted_.end(), uint8_t{0});
  for (const uint32_t output : outputs) {
    for (const int32_t i : out_.subspan(output * n_unfold_, n_unfold_)) {
      if (i != 0) wanted_[static_cast<size_t>(i < 0 ? -i : i) - 1] = 1;
    }
  }
}

// Lists the values of vector 0 that read each input.
void BlockProgram::connect_inputs() {
  const auto input_of = [&](size_t k) { return static_cast<size_t>(in_[k] < 0 ? -in_[k] : in_[k]) - 1; };
  first_slot_.assign(static_cast<size_t>(n_in_) + 1, 0);
  for (size_t k = 0; k < in_.size(); ++k) {
    if (in_[k] != 0) ++first_slot_[input_of(k) + 1];
  }
  for (size_t i = 0; i < static_cast<size_t>(n_in_); ++i) first_slot_[i + 1] += first_slot_[i];
  slot_.resize(first_slot_.back());
  std::vector<uint32_t> at(first_slot_.begin(), first_slot_.end() - 1);
  for (size_t k = 0; k < in_.size(); ++k) {
    if (in_[k] != 0) slot_[at[input_of(k)]++] = static_cast<uint32_t>(k / n_fold_);
  }
}

void BlockProgram::read_all() {
  reads_all_ = true;
  std::fill(live_[0].is_live.begin(), live_[0].is_live.end(), uint8_t{1});
}

void BlockProgram::read(std::span<const uint32_t> inputs) {
  reads_all_ = false;
  read_.assign(inputs.begin(), inputs.end());
  std::fill(input_.begin(), input_.end(), 0);
  std::vector<uint8_t>& is_live = live_[0].is_live;
  std::fill(is_live.begin(), is_live.end(), uint8_t{0});
  for (const uint32_t input : inputs) {
    for (uint32_t k = first_slot_[input]; k < first_slot_[input + 1]; ++k) is_live[slot_[k]] = 1;
  }
}

// Follows the live values of vector 0 through the stages, and lists what is to be multiplied.
void BlockProgram::plan() {
  for (std::vector<int16_t>& values : vector_) std::fill(values.begin(), values.end(), int16_t{0});
  list_ranges(live_[0].is_live, live_[0].range);
  job_.clear();
  block_.clear();
  group_.clear();
  for (size_t s = 0; s < stage_.size(); ++s) {
    const bool is_last = s + 1 == stage_.size();
    if (is_last) last_groups_ = static_cast<uint32_t>(group_.size());
    Live* target = is_last ? nullptr : &live_[s + 1];
    if (target != nullptr) std::fill(target->is_live.begin(), target->is_live.end(), uint8_t{0});
    const Stage& stage = stage_[s];
    for (uint32_t p = stage.first_panel; p < stage.first_panel + stage.n_panels; ++p) plan(p, target);
    if (target != nullptr) list_ranges(target->is_live, target->range);
    end_of_stage_[s] = static_cast<uint32_t>(job_.size());
  }
}

// `target`: of the panel's rows; null: the last stage, whose groups plan_last_groups() lists.
void BlockProgram::plan(uint32_t panel_index, Live* target) {
  const Panel& panel = panel_[panel_index];
  const std::vector<uint8_t>& is_live = live_[panel.source].is_live;
  Job job{.panel = panel_index, .first_block = static_cast<uint32_t>(block_.size())};
  uint32_t column = 0;
  uint32_t first_new = 0;  // blocks below it are judged
  for (uint32_t k = panel.first_segment; k < panel.first_segment + panel.n_segments; ++k) {
    const Segment& segment = segment_[k];
    uint32_t i = 0;
    while (i < segment.count) {
      if (i + 8 <= segment.count && are_eight_zero(&is_live[segment.first + i])) {
        i += 8;
        continue;
      }
      if (is_live[segment.first + i] == 0) {
        ++i;
        continue;
      }
      const auto block = static_cast<uint32_t>((column + i) / kBlock);
      if (block >= first_new) block_.push_back(static_cast<uint16_t>(block));
      first_new = block + 1;
      i = static_cast<uint32_t>(first_new * kBlock) - column;
    }
    column += segment.count;
  }
  job.n_blocks = static_cast<uint32_t>(block_.size()) - job.first_block;
  if (job.n_blocks == 0) return;
  if (target != nullptr) {
    std::fill_n(target->is_live.begin() + panel.first_row, panel.n_rows, uint8_t{1});
    job.first_group = static_cast<uint32_t>(group_.size());
    for (uint32_t r = 0; r < panel.n_rows; r += kRows) group_.push_back(r);
    job.n_groups = static_cast<uint32_t>(group_.size()) - job.first_group;
  }
  job_.push_back(job);
}

void BlockProgram::plan_last_groups() {
  group_.resize(last_groups_);
  for (size_t j = stage_.size() > 1 ? end_of_stage_[stage_.size() - 2] : 0; j < job_.size(); ++j) {
    Job& job = job_[j];
    const Panel& panel = panel_[job.panel];
    job.first_group = static_cast<uint32_t>(group_.size());
    const uint8_t* wanted = &wanted_[panel.first_row];
    for (uint32_t r = 0; r < panel.n_rows; r += kRows) {
      const uint8_t* end = wanted + std::min(r + kRows, panel.n_rows);
      if (std::any_of(wanted + r, end, [](uint8_t w) { return w != 0; })) group_.push_back(r);
    }
    job.n_groups = static_cast<uint32_t>(group_.size()) - job.first_group;
  }
}

void BlockProgram::run(std::span<const int16_t> u, std::span<int64_t> out) {
  fold(u);
  uint32_t job = 0;
  for (size_t s = 0; s < stage_.size(); ++s) {
    std::fill_n(sum_.begin() + 1, stage_[s].n_values, int64_t{0});
    for (; job < end_of_stage_[s]; ++job) multiply(job_[job]);
    if (s + 1 < stage_.size()) store_vector(s + 1, stage_[s].shift);
  }
  with_fold(n_unfold_, [&](auto n) { unfold<n()>(out); });
}

template <size_t kFold>
void BlockProgram::unfold(std::span<int64_t> out) const {
  const Rounding round(out_shift_);
  for (const uint32_t r : selected_) out[r] = round(signed_sum<kFold>(out_.data() + r * kFold, sum_.data()));
}

void BlockProgram::fold(std::span<const int16_t> u) {
  int32_t* const middle = input_.data() + n_in_;
  const auto set = [&](int32_t i) {
    middle[i + 1] = u[static_cast<size_t>(i)];
    middle[-i - 1] = -middle[i + 1];
  };
  if (reads_all_) {
    for (int32_t i = 0; i < n_in_; ++i) set(i);
  } else {
    for (const uint32_t i : read_) set(static_cast<int32_t>(i));
  }
  int32_t largest = 0;
  with_fold(n_fold_, [&](auto n) { largest = fold_ranges<n()>(); });
  const int shift = block_float::shift_for(largest);
  const auto half = static_cast<int32_t>(Rounding(shift).half);
  for (const Segment& range : live_[0].range) {
    for (uint32_t i = range.first; i < range.first + range.count; ++i) {
      vector_[0][i] = static_cast<int16_t>((folded_[i] + half) >> shift);
    }
  }
  exponent_[0] = shift;
}

// Returns the largest magnitude.
template <size_t kFold>
int32_t BlockProgram::fold_ranges() {
  const int32_t* const middle = input_.data() + n_in_;
  int32_t largest = 0;
  for (const Segment& range : live_[0].range) {
    const int32_t* row = in_.data() + range.first * kFold;
    for (uint32_t i = range.first; i < range.first + range.count; ++i, row += kFold) {
      int32_t sum = 0;
      for (size_t k = 0; k < kFold; ++k) sum += middle[row[k]];
      folded_[i] = sum;
      largest = std::max(largest, sum < 0 ? -sum : sum);
    }
  }
  return largest;
}

void BlockProgram::store_vector(size_t index, int shift) {
  const Rounding scale(shift);
  int64_t largest = 0;
  for (const Segment& range : live_[index].range) {
    for (uint32_t i = range.first + 1; i <= range.first + range.count; ++i) {
      const int64_t v = sum_[i] = scale(sum_[i]);
      largest = std::max(largest, v < 0 ? -v : v);
    }
  }
  exponent_[index] = block_float::shift_for(largest);
  const Rounding round(exponent_[index]);
  for (const Segment& range : live_[index].range) {
    int16_t* const out = vector_[index].data() + range.first;
    const int64_t* const sums = sum_.data() + 1 + range.first;
    for (uint32_t i = 0; i < range.count; ++i) out[i] = static_cast<int16_t>(round(sums[i]));
  }
}

// Gathers the panel's part of its source vector, zero padded.
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
}

void BlockProgram::multiply(const Job& job) {
  if (job.n_groups == 0) return;
  const Panel& panel = panel_[job.panel];
  gather(panel);
  const std::span<const uint16_t> blocks(block_.data() + job.first_block, job.n_blocks);
  const int scale = exponent_[panel.source];
  std::array<int64_t, kRows> sums;
  for (uint32_t g = job.first_group; g < job.first_group + job.n_groups; ++g) {
    const uint32_t r = group_[g];
    const uint32_t n = std::min(panel.n_rows - r, kRows);
    const size_t at = panel.at + size_t{r} * panel.n_blocks;
    kernel_(static_cast<int>(n), {&entry_[at * kBlock], &shift_[at]}, gathered_.data(), blocks, sums.data());
    int64_t* const target = &sum_[1 + panel.first_row + r];
    for (uint32_t i = 0; i < n; ++i) target[i] += sums[i] * (int64_t{1} << scale);
  }
}

}  // namespace ruffini
