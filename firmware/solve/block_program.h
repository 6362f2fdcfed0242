// A linear map as a program of block-scaled integer products (proto/CALIBRATION.md, "Programs").
//
//   vector 0   x = sums and differences of at most four inputs (reflection classes), or the inputs themselves
//   vector s   x_s = sum over its panels of (panel times some of an earlier vector)
//   outputs    sums and differences of at most four values of the last vector, rounded: (v + half) >> out_shift
//
// A dense matrix is one panel, a hierarchical one a few stages of small panels. Every vector except the last is kept in
// 16 bits with one common exponent (block_float.h); block_kernel.h computes the products. `load` proves from the tables
// that no accumulator can overflow for any input. Not in the paper. Frame thread; no allocation after load.
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

  // Loads the tensors `<name>.*` for n_in inputs and n_out outputs. Returns kBadInput with the reason if an index is
  // out of range, a table has the wrong size, or an accumulator could overflow.
  [[nodiscard]] static Result<BlockProgram> load(const Calibration& calibration, const std::string& name, int n_in,
                                                 int n_out);

  [[nodiscard]] int n_in() const { return n_in_; }
  [[nodiscard]] int n_out() const { return static_cast<int>(out_.size() / n_unfold_); }

  // Selects the outputs that run() computes (all at first) from all inputs. The values of the other outputs are
  // undefined.
  void select(std::span<const uint32_t> outputs);
  // The same from `inputs` alone: run() takes the others for zero, and skips the blocks that read only those.
  void select(std::span<const uint32_t> outputs, std::span<const uint32_t> inputs);

  // Precondition: u has at least n_in() values. Writes n_out() values to `out`.
  void run(std::span<const int16_t> u, std::span<int64_t> out);

 private:
  friend class BlockProgramLoader;
  struct Stage {
    uint32_t n_values = 0;
    int shift = 0;  // right shift of the accumulators before they are stored in 16 bits; the last stage keeps them wide
    uint32_t first_panel = 0;
    uint32_t n_panels = 0;
  };
  struct Panel {
    uint32_t first_row = 0;
    uint32_t n_rows = 0;
    uint32_t source = 0;  // index of the vector it multiplies
    uint32_t first_segment = 0;
    uint32_t n_segments = 0;
    uint32_t n_blocks = 0;
    size_t at = 0;  // index of its first block in shift_; times kBlock in entry_
  };
  struct Segment {
    uint32_t first = 0;
    uint32_t count = 0;
  };

  // A panel that reads something, and its share of block_ and group_.
  struct Job {
    uint32_t panel = 0;
    uint32_t first_block = 0;
    uint32_t n_blocks = 0;
    uint32_t first_group = 0;
    uint32_t n_groups = 0;
  };
  // A vector without its zeros.
  struct Live {
    std::vector<uint8_t> is_live;  // of each value; false: it is zero for any input
    std::vector<Segment> range;    // the live values
  };

  void connect_inputs();
  void want(std::span<const uint32_t> outputs);
  void read_all();
  void read(std::span<const uint32_t> inputs);
  void plan();
  void plan(uint32_t panel, Live* target);
  void plan_last_groups();
  void fold(std::span<const int16_t> u);
  template <size_t kFold>
  int32_t fold_ranges();
  template <size_t kFold>
  void unfold(std::span<int64_t> out) const;
  void multiply(const Job& job);
  void gather(const Panel& panel);
  // Rounds sum_ to 16 bits and stores it as vector `index`.
  void store_vector(size_t index, int shift);

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
  std::vector<uint32_t> first_slot_;  // of each input in slot_; one more at the end
  std::vector<uint32_t> slot_;        // values of vector 0 that read the input
  std::vector<int32_t> input_;        // -u in reverse, 0, u: as the signed numbers of in_ count from its middle
  std::vector<int32_t> folded_;       // vector 0 before it is rounded
  std::vector<int64_t> sum_;          // of the current stage, after one leading zero, which index 0 of a fold refers to
  std::vector<uint32_t> selected_;
  std::vector<uint8_t> wanted_;  // values of the last stage
  bool reads_all_ = false;
  std::vector<uint32_t> read_;          // inputs, unless all are read
  std::vector<Live> live_;              // of each vector
  std::vector<Job> job_;                // by stage
  std::vector<uint32_t> end_of_stage_;  // in job_
  std::vector<uint16_t> block_;         // of the jobs: blocks that read something live
  std::vector<uint32_t> group_;         // of the jobs: first row of kRows rows of which one is wanted
  uint32_t last_groups_ = 0;            // in group_: those of the last stage
  std::vector<int16_t> gathered_;
};

}  // namespace ruffini
