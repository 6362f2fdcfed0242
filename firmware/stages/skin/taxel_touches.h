// Touches of a skin out of its taxels: how many, where between the taxels, and how hard, with the rubber's memory.
//
//   sink, press   of each taxel by its ratio (image/taxels.h), from tables linear between
//   memory        press less what the rubber lost since it was pressed (solve/relaxation.h)
//   touch k       strength s_k at place X_k: sinks a taxel at X by s_k reach(X - X_k)
//   found         the taxel with the most sink that the touches so far do not explain is another touch, if that is more
//                 than `apart` of its own sink and of the strength of each touch, or of a kBeyond-th of it where that
//                 does not reach, and if it stands out: 2 u_c - u_a - u_b over u_c / kPeak along both axes; then all
//                 are fitted again
//   two           a touch beside which none stands out, whose taxels two places explain so much better (touch_pair.h),
//                 is two touches, and these stay there; for `found` each is as strong as both, which reach further
//   place         on the taxel c that the others leave the most sink u on, with neighbours a, b along an axis:
//                 q = (u_b - u_a) / (u_c - min(u_a, u_b)), or u_a / u_c of the only neighbour; shift = c's cubic in q
//   strength      s = u_c / reach(X_c - X)
//   force         E, the sum of press over the taxels, each shared out by what the touches sink it, times
//                 the gain of c's kind at E, |q_x| and |q_y|
//   sigma         of force: sqrt(constant^2 + (part force)^2); of place: constant + faint threshold / force
//
// Everything by tables of the calibration. Not in the paper. Frame thread; no allocation after load().
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
  static constexpr int kRounds = 3;  // of fitting all touches again
  static constexpr int64_t kBeyond = 3;
  static constexpr int64_t kPeak = 6;

  [[nodiscard]] static Result<TaxelTouches> load(const Calibration& calibration, const BoardSettings& board);

  // `is_believed`: of a frame that is not, the rubber's memory is left as it was.
  SkinTouchList run(std::span<const int32_t> ratio, uint64_t capture_us, bool is_believed,
                    SaturationCounter& saturations);
  // Nothing ever touched the skin.
  void forget();

  [[nodiscard]] const TaxelTables& tables() const { return tables_; }
  // Of the last frame: force of each taxel in force steps, relaxation taken off.
  [[nodiscard]] std::span<const NodeForce> press() const { return press_; }

 private:
  struct Touch {
    size_t taxel = 0;
    int64_t x_um = 0;
    int64_t y_um = 0;
    int64_t strength_q12 = 0;
    std::array<int64_t, 2> q_q12{};
    int64_t pair_q12 = 0;  // strength of both where it is one of a pair, else 0
  };

  void read(std::span<const int32_t> ratio);
  [[nodiscard]] int64_t explained(size_t taxel, const Touch& touch) const;
  [[nodiscard]] int64_t left(size_t taxel, const Touch* except) const;
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
  void share_out();
  [[nodiscard]] SkinTouch told(size_t k) const;

  TaxelTables tables_;
  std::optional<Relaxation> relaxation_;
  int64_t force_lsb_un_ = 1;
  int64_t threshold_un_ = 0;
  SkinMode mode_ = SkinMode::kAuto;
  std::vector<int64_t> sink_q12_;
  std::vector<int64_t> left_q12_;  // of the touch that may be two
  TouchPair pair_;
  std::vector<NodeForce> press_;    // z alone, positive into the skin
  std::vector<uint8_t> all_nodes_;  // the relaxation's mask: every taxel is always measured
  std::array<Touch, SkinTouchList::kMax> touch_{};
  std::array<int64_t, SkinTouchList::kMax> force_lsb_{};
  std::array<int64_t, SkinTouchList::kMax> n_taxels_{};
  size_t n_touches_ = 0;
};

}  // namespace ruffini
