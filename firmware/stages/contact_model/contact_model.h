// One contact out of a texture's flow, guided by contact models: how deep, how wide, planar or Hertzian, and how hard
// the object is.
//
//   x          u_r / size of the profile (Q14), log2 of its size and of the normal force (Q10): 18 numbers
//   size       perceptron of x: gel depth and press depth over the profile's size; root of contact and effective area
//   kind       log odds of planar contact, linear in three numbers of the press: the mean of a perceptron of x, and the
//              slopes of log2 of the force and of the profile's mean radius over log2 of its size. Planar contact keeps
//              its area, so that all grow alike; a ball's grows. sure = (1 + tanh(|odds| / 2)) / 2
//   hardness   Shore A, a perceptron of x for each kind, mean over the press weighted by depth
//   moment     k S_t, which the paper takes for the moment about z; the integral itself is the wrench's
//   H_m        dP/dd by least squares, P = F_n / S_e                                             the paper's eq. (9), (10)
//   strange    no model holds where the mean square of x's first 16, whitened by those of the calibration, is too much;
//              or a perceptron of x (1 of faces with gaps and of objects softer than the gel, 0 of others) says more
//              than it does of the presses that were left out of its fit
//
// What is averaged over a press are frames 0.4 to 1.8 mm deep, loaded straight (F_t <= F_n / 10), not on the way back. It
// begins where nothing was touched. After more than two frames in a row that are not believed, or half a second without
// one that is, another object may lie there: kind and hardness are not told until nothing is touched. Beyond 2.5 mm of
// gel depth the frame is over range. Where more than a quarter of the patches about the contact are lost, nothing is
// told. The paper fits lines of the density and of sqrt(S) d; ours are fitted on the profile. Frame thread; no
// allocation after load.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "core/results.h"
#include "estimators/perceptron.h"
#include "estimators/wrench.h"
#include "stages/contact_model/contact_profile.h"
#include "store/calibration.h"

namespace ruffini {

class ContactModel {
 public:
  static constexpr size_t kInputs = ModelledContact::kInputs;
  static constexpr int64_t kLeastDepthUm = 400;  // where hardness is measured (paper, section V-B)
  static constexpr int64_t kMostDepthUm = 1'800;
  static constexpr int64_t kRangeUm = 2'500;  // paper, section V-A
  static constexpr size_t kBands = 10;        // of Shore A
  static constexpr int64_t kLeastFrames = 3;
  static constexpr int kMostUnseen = 2;               // in a row: nobody exchanges an object in three intervals
  static constexpr uint64_t kMostUnseenUs = 500'000;  // between two frames that are believed
  using Inputs = ModelledContact::Inputs;

  // Kind "contact_model" of the calibration. Errors: kBadInput.
  [[nodiscard]] static Result<ContactModel> load(const Calibration& calibration);

  // `is_believed`: of a frame that is not, the press remembers nothing. `capture_us`: 0 is not known.
  const ModelledContact& run(const Profile& profile, const Wrench& wrench, bool is_believed, uint64_t capture_us,
                             SaturationCounter& saturations);
  // Nothing was touched before.
  void forget();
  [[nodiscard]] const ModelledContact& contact() const { return contact_; }
  // x of the last frame that was touched.
  [[nodiscard]] const Inputs& inputs() const { return inputs_; }

 private:
  static constexpr size_t kSizes = 4;
  // Sums of a line by least squares.
  struct Line {
    int64_t x = 0;
    int64_t y = 0;
    int64_t x_x = 0;
    int64_t x_y = 0;
    void add(int64_t at, int64_t value);
    [[nodiscard]] int64_t slope(int64_t n, int64_t scale) const;  // times scale; 0 where x is the same all along
  };
  // Sums over a press, weighted by depth but for those of the lines.
  struct Press {
    int64_t n = 0;
    int64_t weight = 0;
    int64_t kind = 0;
    int64_t strange = 0;
    int64_t fails = 0;
    std::array<int64_t, 2> shore{};
    int64_t deepest_um = 0;
    Line pressure;  // over depth
    Line force;     // over the profile's size, and its mean radius: log2, Q10
    Line radius;
  };

  [[nodiscard]] Status load_strange(const Calibration& calibration);
  [[nodiscard]] Status load_sigma(const Calibration& calibration);
  [[nodiscard]] Status load_odds(const Calibration& calibration);
  [[nodiscard]] static Inputs inputs_of(const Profile& profile, int64_t press_un);
  void tell_size(const Inputs& x, const Profile& profile, SaturationCounter& saturations);
  void remember(const Inputs& x, const Profile& profile, const Wrench& wrench, SaturationCounter& saturations);
  void tell_press();
  // Before the frame is used. Could the object have been exchanged since the last one that was seen?
  void watch_gap(bool is_seen, uint64_t capture_us);
  [[nodiscard]] int64_t strange_q8(const Inputs& x) const;
  [[nodiscard]] int64_t odds_q12() const;

  TanhTable tanh_;
  Perceptron size_;
  Perceptron kind_;
  Perceptron fails_;
  std::array<Perceptron, 2> hardness_;  // planar, Hertzian
  std::vector<int32_t> whitening_;      // [16][16] of x less its mean, both Q14; z Q8 after kWhiteShift
  std::vector<int16_t> mean_;
  std::array<std::array<int32_t, kBands>, 2> sigma_q4_{};  // by kind and tens of Shore A
  std::array<int64_t, 4> odds_q12_{};                      // offset, weights of the three numbers
  int64_t most_strange_q8_ = 0;
  int64_t most_failing_q12_ = 0;
  int64_t least_fall_q16_ = 0;
  int64_t least_force_un_ = 0;
  int64_t depth_sigma_um_ = 0;
  int64_t moment_per_flow_ = 0;  // uN mm a um
  Press press_;
  bool is_interrupted_ = false;  // what presses now may not be what began to
  int n_unseen_ = 0;
  uint64_t seen_us_ = 0;
  Inputs inputs_{};
  ModelledContact contact_;
};

// log2(x), Q10; 0 for x < 1.
[[nodiscard]] int64_t log2_q10(int64_t x);

}  // namespace ruffini
