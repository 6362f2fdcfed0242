// Estimates one contact from a texture's flow by contact models: depth, width, planar or Hertzian contact, and the
// hardness of the object.
//
//   x          u_r / size of the profile (Q14), log2 of its size and of the normal force (Q10): 18 numbers
//   size       perceptron of x: gel depth and press depth over the profile's size; square roots of contact area and
//              effective area
//   kind       log odds of planar contact, linear in three numbers of the press: the mean of a perceptron of x, and the
//              slopes of log2 of the force and of the profile's mean radius over log2 of its size. A planar contact
//              keeps its area, a ball's grows. confidence = (1 + tanh(|odds| / 2)) / 2
//   hardness   Shore A, a perceptron of x for each kind; depth-weighted mean over the press
//   moment     k S_t, which the paper uses as the moment about z; the integral itself belongs to the wrench
//   H_m        dP/dd by least squares, P = F_n / S_e                                     the paper's eq. (9), (10)
//   outlier    (is_strange) no model applies: the mean square of the first 16 numbers of x, whitened by those of the
//              calibration, is too large; or a perceptron of x (1 for faces with gaps and objects softer than the gel,
//              0 for others) exceeds its values for the presses that were left out of its fit
//
// The averages over a press use frames 0.4 to 1.8 mm deep with a straight load (F_t <= F_n / 10) while the depth
// increases. A press begins after a frame without contact. After more than two untrusted frames in a row, or half a
// second without a trusted one, the object may have been exchanged: kind and hardness are not reported until contact
// ends. Beyond 2.5 mm of gel depth the frame is over range. If more than a quarter of the patches around the contact
// are lost, nothing is reported. The paper fits lines of the density and of sqrt(S) d; this implementation fits the
// profile. Frame thread; no allocation after load.
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
  static constexpr int64_t kMinHardnessDepthUm = 400;  // depth range for hardness (paper, section V-B)
  static constexpr int64_t kMaxHardnessDepthUm = 1'800;
  static constexpr int64_t kRangeUm = 2'500;  // paper, section V-A
  static constexpr size_t kBands = 10;        // of Shore A
  static constexpr int64_t kMinFrames = 3;
  static constexpr int kMaxUnseen = 2;               // in a row: nobody exchanges an object within three intervals
  static constexpr uint64_t kMaxUnseenUs = 500'000;  // between two trusted frames
  using Inputs = ModelledContact::Inputs;

  // Loads kind "contact_model" of the calibration. Errors: kBadInput.
  [[nodiscard]] static Result<ContactModel> load(const Calibration& calibration);

  // `is_trusted`: frames that are not are excluded from the press. `capture_us`: 0 if unknown.
  const ModelledContact& run(const Profile& profile, const Wrench& wrench, bool is_trusted, uint64_t capture_us,
                             SaturationCounter& saturations);
  // Resets the history: nothing was touched before.
  void forget();
  [[nodiscard]] const ModelledContact& contact() const { return contact_; }
  // x of the last frame with contact.
  [[nodiscard]] const Inputs& inputs() const { return inputs_; }

 private:
  static constexpr size_t kSizes = 4;
  // Sums for a line fitted by least squares.
  struct Line {
    int64_t x = 0;
    int64_t y = 0;
    int64_t x_x = 0;
    int64_t x_y = 0;
    void add(int64_t at, int64_t value);
    [[nodiscard]] int64_t slope(int64_t n, int64_t scale) const;  // times scale; 0 if x is constant
  };
  // Sums over a press, weighted by depth except those of the lines.
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
  void estimate_size(const Inputs& x, const Profile& profile, SaturationCounter& saturations);
  void accumulate(const Inputs& x, const Profile& profile, const Wrench& wrench, SaturationCounter& saturations);
  void estimate_from_press();
  // Call before a frame is used. Checks whether the object could have been exchanged since the last trusted frame.
  void check_gap(bool is_seen, uint64_t capture_us);
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
  int64_t max_strange_q8_ = 0;
  int64_t max_failing_q12_ = 0;
  int64_t min_fall_q16_ = 0;
  int64_t min_force_un_ = 0;
  int64_t depth_sigma_um_ = 0;
  int64_t moment_per_flow_ = 0;  // uN mm per um
  Press press_;
  bool is_interrupted_ = false;  // the current object may differ from the one that began the press
  int n_unseen_ = 0;
  uint64_t seen_us_ = 0;
  Inputs inputs_{};
  ModelledContact contact_;
};

// log2(x), Q10; 0 for x < 1.
[[nodiscard]] int64_t log2_q10(int64_t x);

}  // namespace ruffini
