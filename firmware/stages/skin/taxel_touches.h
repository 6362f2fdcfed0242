// Finds the touches of a skin from its taxels: number, positions between the taxels, and force with relaxation.
//
//   sink, press   of each taxel from its ratio (image/taxels.h), by tables, linear between
//   relaxation    press minus what the rubber lost since it was pressed (solve/relaxation.h)
//   touch k       strength s_k at position X_k: sinks a taxel at X by s_k reach(X - X_k)
//   found         the taxel with the most unexplained sink is another touch if that exceeds `apart` times its own sink
//                 and times the strength of each touch (a kBeyond-th of it out of its reach), and if it stands out:
//                 2 u_c - u_a - u_b over u_c / kPeak along both axes; then all touches are fitted again
//   two           a touch without such a neighbour is two touches if two positions explain its taxels that much better
//                 (touch_pair.h); these stay fixed, and count with their joint strength in `found`, as both reach
//                 further
//   place         on the taxel c with the largest residual sink u, with neighbours a, b along an axis:
//                 q = (u_b - u_a) / (u_c - min(u_a, u_b)), or u_a / u_c with one neighbour only; shift = c's cubic in q
//   strength      s = u_c / reach(X_c - X)
//   force         E, the sum of press over the taxels, distributed by the touches' shares of the sink, times the gain
//                 of c's kind at E, |q_x| and |q_y|
//   sigma         of c's kind; of force: sqrt(constant^2 + (part force)^2); of place: constant + faint threshold / force
//
// All tables come from the calibration. Not in the paper. Frame thread; no allocation after load().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "core/results.h"
#include "solve/relaxation.h"
#include "stages/skin/taxel_tables.h"
#include "stages/skin/touch_pair.h"

namespace ruffini {

class TaxelTouches {
 public:
  static constexpr int kRounds = 3;  // rounds of refitting all touches
  static constexpr int64_t kBeyond = 3;
  static constexpr int64_t kPeak = 6;

  [[nodiscard]] static Result<TaxelTouches> load(const Calibration& calibration, const BoardSettings& board);

  // `is_trusted`: if false, the state of the relaxation does not advance.
  SkinTouchList run(std::span<const int32_t> ratio, uint64_t capture_us, bool is_trusted,
                    SaturationCounter& saturations);
  // Resets the relaxation to a skin that was never touched.
  void forget();

  [[nodiscard]] const TaxelTables& tables() const { return tables_; }
  // Force of each taxel in the last frame, in force steps, corrected for relaxation.
  [[nodiscard]] std::span<const NodeForce> press() const { return press_; }

 private:
  struct Touch {
    size_t taxel = 0;
    int64_t x_um = 0;
    int64_t y_um = 0;
    int64_t strength_q12 = 0;
    std::array<int64_t, 2> q_q12{};
    int64_t pair_q12 = 0;  // joint strength if it is one of a pair, else 0
  };

  void read(std::span<const int32_t> ratio);
  [[nodiscard]] int64_t explained(size_t taxel, const Touch& touch) const;
  [[nodiscard]] int64_t residual_sink(size_t taxel, const Touch* except) const;
  [[nodiscard]] bool is_peak(size_t taxel) const;
  [[nodiscard]] std::optional<size_t> next_taxel() const;
  [[nodiscard]] bool find_another();
  void fit(Touch& touch) const;
  void split_last();
  [[nodiscard]] Touch member(size_t k) const;
  [[nodiscard]] int64_t within_round(int64_t x_um) const;
  void lean(Touch& touch, int64_t here) const;
  [[nodiscard]] int64_t lean_q12(const TaxelTables::Taxel& taxel, const Touch& touch, size_t axis, int64_t here) const;
  [[nodiscard]] int64_t force_un(const Touch& touch, int64_t elastic_lsb) const;
  void distribute_press();
  [[nodiscard]] SkinTouch to_skin_touch(size_t k) const;

  TaxelTables tables_;
  std::optional<Relaxation> relaxation_;
  int64_t force_lsb_un_ = 1;
  int64_t threshold_un_ = 0;
  SkinMode mode_ = SkinMode::kAuto;
  std::vector<int64_t> sink_q12_;
  std::vector<int64_t> residual_q12_;  // around the touch that may be two
  TouchPair pair_;
  std::vector<NodeForce> press_;    // z only, positive into the skin
  std::vector<uint8_t> all_nodes_;  // mask for the relaxation: every taxel is always measured
  std::array<Touch, SkinTouchList::kMax> touch_{};
  std::array<int64_t, SkinTouchList::kMax> force_lsb_{};
  std::array<int64_t, SkinTouchList::kMax> n_taxels_{};
  size_t n_touches_ = 0;
};

}  // namespace ruffini
