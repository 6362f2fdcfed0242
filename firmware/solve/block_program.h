// A linear map as a program of block-scaled integer products (proto/CALIBRATION.md, "Programs").
//
//   vector 0   x = sums and differences of at most four inputs (reflection classes), or the inputs themselves
//   vector s   x_s = sum over its panels of (panel times some of an earlier vector)
//   outputs    sums and differences of at most four values of the last vector, rounded: (v + half) >> out_shift
//
// A dense matrix is one panel; a hierarchical one is a few stages of small panels. Every vector but the
// last is kept in 16 bits with one common exponent (block_float.h); products are those of block_kernel.h.
// `load` proves from the tables it got that no accumulator can overflow, whatever the inputs. Not in the
// paper. Frame thread; no allocation after load.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"
#include "solve/block_kernel.h"
#include "store/calibration.h"

namespace ruffini {

class BlockProgram {
 public:
  BlockProgram() = default;

  // Tensors `<name>.*` for n_in inputs and n_out outputs. kBadInput with the reason where an index leads
  // outside, a table is of another size, or an accumulator could overflow.
  [[nodiscard]] static Result<BlockProgram> load(const Calibration& calibration, const std::string& name, int n_in,
                                                 int n_out);

  [[nodiscard]] int n_in() const { return n_in_; }
  [[nodiscard]] int n_out() const { return static_cast<int>(out_.size() / n_unfold_); }

  // The outputs that `run` must find from now on (all of them at first); the others become anything.
  void select(std::span<const uint32_t> outputs);

  // u: at least n_in() values. out: n_out() values.
  void run(std::span<const int16_t> u, std::span<int64_t> out);

 private:
  friend class BlockProgramLoader;
  struct Stage {
    uint32_t n_values = 0;
    int shift = 0;  // of the accumulators, before they are kept in 16 bits; the last stage keeps them wide
    uint32_t first_panel = 0;
    uint32_t n_panels = 0;
  };
  struct Panel {
    uint32_t first_row = 0;
    uint32_t n_rows = 0;
    uint32_t source = 0;  // vector
    uint32_t first_segment = 0;
    uint32_t n_segments = 0;
    uint32_t n_blocks = 0;
    size_t at = 0;  // of its first block in shift_; times kBlock in entry_
  };
  struct Segment {
    uint32_t first = 0;
    uint32_t count = 0;
  };

  void fold(std::span<const int16_t> u);
  void multiply(const Panel& panel, bool is_last);
  void gather(const Panel& panel);
  // sum_ -> vector `index`
  void keep(size_t index, size_t n_values);

  std::span<const int16_t> entry_;
  std::span<const uint8_t> shift_;
  std::span<const int32_t> in_;   // (n slots, n_fold_): +-(input + 1), 0 none
  std::span<const int32_t> out_;  // (n_out, n_unfold_): +-(value + 1), 0 none
  size_t n_fold_ = 1;
  size_t n_unfold_ = 1;
  int n_in_ = 0;
  int out_shift_ = 1;
  std::vector<Stage> stage_;
  std::vector<Panel> panel_;
  std::vector<Segment> segment_;
  block_kernel::Rows kernel_ = block_kernel::rows_scalar;
  std::vector<std::vector<int16_t>> vector_;
  std::vector<int> exponent_;
  std::vector<int64_t> input_;  // as sum_
  std::vector<int64_t> sum_;    // of the stage at work, behind one zero: what index 0 of a fold names
  std::vector<uint32_t> selected_;
  std::vector<uint8_t> wanted_;  // values of the last stage
  std::vector<int16_t> gathered_;
  std::vector<uint16_t> blocks_;  // of gathered_ that are not zero
};

}  // namespace ruffini
