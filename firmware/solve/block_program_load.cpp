// Loads a block program: checks every index and size, and proves the accumulator bounds from the tables.
//
// Proof, in integers. Vector 0: |sum| <= 32768 n_fold. A vector bounded by B is stored as v16 2^e with e at most
// shift_for(B), so |v16 2^e| <= B + 2^e =: C. A row of a panel adds at most (sum of |q| 2^shift) C. The sum over a
// row's panels must stay within 2^62 (over all folded values, for the last stage); it bounds the next vector. Inside a
// block, four products of |q| <= 16383 with int16 fit int32.
#include <algorithm>
#include <numeric>

#include "solve/block_float.h"
#include "solve/block_program.h"

namespace ruffini {
namespace {

constexpr size_t kBlock = block_kernel::kBlock;
constexpr uint64_t kSumLimit = uint64_t{1} << 62;
// Of a vector before it is rounded to 16 bits: far above any real use
constexpr uint64_t kKeptLimit = uint64_t{1} << 46;
constexpr int kMaxShift = 40;
constexpr int64_t kMaxValues = 65'536;  // of one vector
constexpr size_t kMaxStages = 32;
constexpr int64_t kMaxFold = 4;

}  // namespace

class BlockProgramLoader {
 public:
  BlockProgramLoader(const Calibration& calibration, const std::string& name) : file_(calibration), name_(name) {}

  Result<BlockProgram> run(int n_in, int n_out) {
    p_.n_in_ = n_in;
    p_.kernel_ = block_kernel::fastest_supported();
    std::string problem = tables(n_out);
    if (problem.empty()) problem = stages();
    if (problem.empty()) problem = panels();
    if (problem.empty()) problem = folds();
    if (problem.empty()) problem = bounds();
    if (!problem.empty()) {
      return Error{ErrorKind::kBadInput, "calibration file: " + name_ + ": " + problem + ": compile it again"};
    }
    p_.vector_.resize(p_.stage_.size());
    p_.exponent_.resize(p_.stage_.size());
    p_.live_.resize(p_.stage_.size());
    p_.end_of_stage_.resize(p_.stage_.size());
    size_t most_values = n_slots_;
    for (size_t s = 0; s < p_.stage_.size(); ++s) {
      const size_t n = length(s);
      p_.vector_[s].resize(n);
      p_.live_[s].is_live.resize(n);
      p_.live_[s].range.reserve(n / 2 + 1);
      most_values = std::max<size_t>(most_values, p_.stage_[s].n_values);
    }
    p_.sum_.resize(1 + most_values);
    p_.folded_.resize(n_slots_);
    p_.input_.resize(2 * static_cast<size_t>(n_in) + 1);
    p_.read_.reserve(static_cast<size_t>(n_in));
    p_.wanted_.resize(p_.stage_.back().n_values);
    size_t most_blocks = 0;
    size_t n_blocks = 0;
    size_t n_groups = 0;
    for (const auto& panel : p_.panel_) {
      most_blocks = std::max<size_t>(most_blocks, panel.n_blocks);
      n_blocks += panel.n_blocks;
      n_groups += (panel.n_rows + block_kernel::kRows - 1) / block_kernel::kRows;
    }
    p_.gathered_.resize(most_blocks * kBlock);
    p_.job_.reserve(p_.panel_.size());
    p_.block_.reserve(n_blocks);
    p_.group_.reserve(n_groups);
    p_.connect_inputs();
    std::vector<uint32_t> all(static_cast<size_t>(n_out));
    std::iota(all.begin(), all.end(), 0U);
    p_.select(all);
    return std::move(p_);
  }

 private:
  const Tensor* find(const char* what, Tensor::Type type, size_t rank) {
    const Tensor* t = file_.tensor(name_ + what);
    return t != nullptr && t->type == type && t->shape.size() == rank ? t : nullptr;
  }

  std::string tables(int n_out) {
    const Tensor* entry = find(".entry", Tensor::Type::kI16, 1);
    const Tensor* shift = find(".shift", Tensor::Type::kU8, 1);
    const Tensor* fold = find(".fold", Tensor::Type::kI32, 2);
    const Tensor* unfold = find(".unfold", Tensor::Type::kI32, 2);
    stage_ = find(".stage", Tensor::Type::kI32, 2);
    panel_ = find(".panel", Tensor::Type::kI32, 2);
    segment_ = find(".segment", Tensor::Type::kI32, 2);
    if (entry == nullptr || shift == nullptr || fold == nullptr || unfold == nullptr || stage_ == nullptr ||
        panel_ == nullptr || segment_ == nullptr) {
      return "one of its tensors entry, shift, fold, unfold, stage, panel, segment is missing or of another type";
    }
    if (fold->shape[0] > kMaxValues || fold->shape[1] > kMaxFold || unfold->shape[0] != n_out ||
        unfold->shape[1] > kMaxFold || stage_->shape[1] != 2 || panel_->shape[1] != 6 || segment_->shape[1] != 2) {
      return "its fold, unfold, stage, panel or segment has another shape than this board needs";
    }
    if (entry->shape[0] != shift->shape[0] * static_cast<int64_t>(kBlock)) return "entry and shift do not match";
    const auto out_shift = file_.integer(name_ + ".out_shift", 1, 60);
    if (!out_shift) return "out_shift is not from 1 to 60";
    p_.out_shift_ = static_cast<int>(out_shift.value());
    p_.entry_ = entry->as<int16_t>();
    p_.shift_ = shift->as<uint8_t>();
    p_.in_ = fold->as<int32_t>();
    p_.out_ = unfold->as<int32_t>();
    p_.n_fold_ = static_cast<size_t>(fold->shape[1]);
    p_.n_unfold_ = static_cast<size_t>(unfold->shape[1]);
    n_slots_ = static_cast<size_t>(fold->shape[0]);
    return "";
  }

  std::string stages() {
    const auto rows = stage_->as<int32_t>();
    if (rows.size() / 2 > kMaxStages) return "too many stages";
    for (size_t s = 0; s < rows.size(); s += 2) {
      if (rows[s] < 1 || rows[s] > kMaxValues || rows[s + 1] < 0 || rows[s + 1] > 61) return "a stage makes no sense";
      p_.stage_.push_back({static_cast<uint32_t>(rows[s]), rows[s + 1], 0, 0});
    }
    const auto segments = segment_->as<int32_t>();
    for (size_t k = 0; k < segments.size(); k += 2) {
      if (segments[k] < 0 || segments[k] > kMaxValues || segments[k + 1] < 1 || segments[k + 1] > kMaxValues) {
        return "a segment makes no sense";
      }
      p_.segment_.push_back({static_cast<uint32_t>(segments[k]), static_cast<uint32_t>(segments[k + 1])});
    }
    return "";
  }

  // Returns the length of vector `index`: the folded inputs, or the output of an earlier stage.
  [[nodiscard]] size_t length(size_t index) const { return index == 0 ? n_slots_ : p_.stage_[index - 1].n_values; }

  std::string panels() {
    const auto rows = panel_->as<int32_t>();
    const auto stage_of = [&](size_t i) { return static_cast<size_t>(rows[i]); };
    size_t at = 0;
    for (size_t i = 0; i < rows.size(); i += 6) {
      if (std::any_of(&rows[i], &rows[i] + 6, [](int32_t v) { return v < 0; })) return "a panel has a negative number";
      if (stage_of(i) >= p_.stage_.size() || (i > 0 && stage_of(i) < stage_of(i - 6))) return "panels are out of order";
      auto& stage = p_.stage_[stage_of(i)];
      BlockProgram::Panel panel{static_cast<uint32_t>(rows[i + 1]),
                                static_cast<uint32_t>(rows[i + 2]),
                                static_cast<uint32_t>(rows[i + 3]),
                                static_cast<uint32_t>(rows[i + 4]),
                                static_cast<uint32_t>(rows[i + 5]),
                                0,
                                at};
      if (panel.n_rows == 0 || size_t{panel.first_row} + panel.n_rows > stage.n_values) return "a panel is too tall";
      if (panel.source > stage_of(i)) return "a panel reads a vector that is not there yet";
      if (panel.n_segments == 0 || size_t{panel.first_segment} + panel.n_segments > p_.segment_.size()) {
        return "a panel names segments that are not there";
      }
      size_t n_columns = 0;
      for (size_t k = panel.first_segment; k < size_t{panel.first_segment} + panel.n_segments; ++k) {
        const auto& segment = p_.segment_[k];
        if (size_t{segment.first} + segment.count > length(panel.source)) return "a segment leads outside its vector";
        n_columns += segment.count;
      }
      if (n_columns > size_t{kMaxValues}) return "a panel is too wide";
      panel.n_blocks = static_cast<uint32_t>((n_columns + kBlock - 1) / kBlock);
      at += size_t{panel.n_blocks} * panel.n_rows;
      if (at > p_.shift_.size()) return "its panels are larger than its entries";
      if (stage.n_panels++ == 0) stage.first_panel = static_cast<uint32_t>(p_.panel_.size());
      p_.panel_.push_back(panel);
    }
    return at == p_.shift_.size() ? "" : "its panels are smaller than its entries";
  }

  std::string folds() {
    const auto is_inside = [](std::span<const int32_t> row, int64_t n) {
      return std::all_of(row.begin(), row.end(), [n](int32_t i) { return (i < 0 ? -int64_t{i} : int64_t{i}) <= n; });
    };
    if (!is_inside(p_.in_, p_.n_in_)) return "fold names an input that is not there";
    if (p_.stage_.empty()) return "it has no stage";
    if (!is_inside(p_.out_, p_.stage_.back().n_values)) return "unfold names a value that is not there";
    return "";
  }

  std::string bounds() {
    const char* overflow = "an accumulator could overflow";
    for (const int16_t q : p_.entry_) {
      if (q < -block_kernel::kMaxEntry || q > block_kernel::kMaxEntry) return overflow;
    }
    if (std::any_of(p_.shift_.begin(), p_.shift_.end(), [](uint8_t s) { return s > kMaxShift; })) return overflow;
    std::vector<uint64_t> kept = {bound_of_kept(uint64_t{32'768} * p_.n_fold_)};  // C of each vector
    for (const auto& stage : p_.stage_) {
      const bool is_last = &stage == &p_.stage_.back();
      std::vector<uint64_t> sum(stage.n_values);
      for (uint32_t k = 0; k < stage.n_panels; ++k) {
        if (!add_bounds(p_.panel_[stage.first_panel + k], kept, sum)) return overflow;
      }
      const uint64_t largest = *std::max_element(sum.begin(), sum.end());
      if (is_last) return largest > kSumLimit / p_.n_unfold_ ? overflow : "";
      const uint64_t next = (largest >> stage.shift) + 1;
      if (next > kKeptLimit) return overflow;
      kept.push_back(bound_of_kept(next));
    }
    return "";
  }

  static uint64_t bound_of_kept(uint64_t bound) {
    return bound + (uint64_t{1} << block_float::shift_for(static_cast<int64_t>(bound)));
  }

  bool add_bounds(const BlockProgram::Panel& panel, const std::vector<uint64_t>& kept, std::vector<uint64_t>& sum) {
    const uint64_t limit = kSumLimit / kept[panel.source];  // for the weight of a row
    for (uint32_t r = 0; r < panel.n_rows; ++r) {
      const uint32_t group = r / block_kernel::kRows * block_kernel::kRows;
      const uint32_t n = std::min<uint32_t>(panel.n_rows - group, block_kernel::kRows);
      uint64_t weight = 0;
      for (size_t b = 0; b < panel.n_blocks; ++b) {
        const size_t at = panel.at + size_t{group} * panel.n_blocks + b * n + (r - group);
        uint64_t block = 0;
        for (size_t j = at * kBlock; j < (at + 1) * kBlock; ++j) {
          block += static_cast<uint64_t>(p_.entry_[j] < 0 ? -p_.entry_[j] : p_.entry_[j]);
        }
        weight += block << p_.shift_[at];  // below 2^19 2^40
        if (weight > limit) return false;
      }
      uint64_t& total = sum[panel.first_row + r];
      total += weight * kept[panel.source];
      if (total > kSumLimit) return false;
    }
    return true;
  }

  const Calibration& file_;
  std::string name_;
  BlockProgram p_;
  const Tensor* stage_ = nullptr;
  const Tensor* panel_ = nullptr;
  const Tensor* segment_ = nullptr;
  size_t n_slots_ = 0;
};

Result<BlockProgram> BlockProgram::load(const Calibration& calibration, const std::string& name, int n_in, int n_out) {
  return BlockProgramLoader(calibration, name).run(n_in, n_out);
}

}  // namespace ruffini
