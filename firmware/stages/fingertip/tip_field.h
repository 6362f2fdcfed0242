// Displacement field of the pins inside a round fingertip, seen by two eyes: the touched place, and the field around
// it, rotated to the top, where every place of a sphere is equivalent. Not in the paper.
//
//   u_p = M_p d_p                          d: shifts of a pin in both eyes, px; M for both eyes, or for one alone
//   w_p = max(-n_p . u_p - 77/256 of the largest, 0)       n: outward normal at the pin
//   c   = sum w n / |sum w n|              centre of the pressed area; R rotates it to (0, 0, 1) by the shortest way
//   f_g = sum_p K(|R n_p - g|^2) R u_p / (sum_p K + 1/20)  at places g around the top; also c_x, c_y times 500 um
//
// A pin is excluded if a required eye lost it or has low confidence, or if both eyes have high confidence and
// contradict each other: four shifts determine three numbers, and the part that no motion of the pin explains, e = |n .
// d| with M n = 0 and |n| = 1, exceeds 1/8 px + |d| / 32. In 4,725 frames of good presses (SIMULATED) e is at most 0.13
// px and no pin is excluded.
//
// Pins are identified by their rest positions. u, f in 1/16 um, directions Q14. Frame thread; no allocation after
// load().
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "image/markers.h"
#include "store/calibration.h"

namespace ruffini {

enum class Eyes : uint8_t { kBoth, kLeft, kRight, kCount };

// Returns which of the left (0) and right (1) eye see, or nothing if neither does.
template <typename Sees>
[[nodiscard]] std::optional<Eyes> seeing_eyes(const Sees& sees) {
  if (sees(0)) return sees(1) ? Eyes::kBoth : Eyes::kLeft;
  return sees(1) ? std::optional(Eyes::kRight) : std::nullopt;
}

class TipField {
 public:
  static constexpr int64_t kMaxPins = 2'048;
  static constexpr int64_t kMaxPlaces = 512;
  static constexpr int64_t kEyes = 2;
  static constexpr int kUnit = 14;                // fraction bits of directions
  static constexpr int64_t kKernelSteps = 2'048;  // of |R n - g|^2, each 2^-15
  using Vector = Eigen::Matrix<int64_t, 3, 1>;
  using Matrix = Eigen::Matrix<int64_t, 3, 3>;  // Q14
  using Gain = Eigen::Matrix<int64_t, 3, 4, Eigen::RowMajor>;
  using Shifts = Eigen::Matrix<int64_t, 4, 1>;  // x and y of the left, then of the right eye

  // Errors: kBadInput.
  [[nodiscard]] static Result<TipField> load(const Calibration& calibration);

  // Matches markers at rest to pins; markers of the left eye come first.
  void learn(std::span<const Marker> markers);
  // Number of pins that the rest picture shows in these eyes; only those are used.
  [[nodiscard]] int n_pins_there(Eyes eyes) const;
  [[nodiscard]] int n_pins() const { return static_cast<int>(pin_.size()); }

  // Returns true if something presses. Only then the results below belong to this frame.
  bool run(std::span<const Marker> markers, Eyes eyes);
  [[nodiscard]] int n_contradicted() const { return n_contradicted_; }  // by the other eye
  [[nodiscard]] std::span<const int32_t> features() const { return features_; }
  [[nodiscard]] size_t n_features() const { return features_.size(); }
  [[nodiscard]] const Matrix& turn() const { return turn_; }      // R
  [[nodiscard]] const Vector& middle() const { return middle_; }  // c
  // The field at a direction about the top.
  [[nodiscard]] Vector at(const Vector& direction) const;
  // A product with directions, in the unit of the other factor.
  [[nodiscard]] static Vector rounded(const Vector& product) {
    return product.unaryExpr([](int64_t each) { return round_shift(each, kUnit); });
  }

 private:
  struct Pin {
    std::array<std::array<int64_t, 2>, kEyes> rest_q8{};  // px
    Vector normal = Vector::Zero();
    std::array<int, kEyes> marker{-1, -1};
    std::array<Gain, static_cast<size_t>(Eyes::kCount)> gain;  // M, um per px Q8
    Shifts still = Shifts::Zero();                             // n of both eyes, Q14
    Vector moved = Vector::Zero();                             // u
    Vector turned = Vector::Zero();                            // R n
    bool is_used = false;                                      // in this frame

    [[nodiscard]] bool is_there(Eyes eyes) const {
      return (marker[0] >= 0 || eyes == Eyes::kRight) && (marker[1] >= 0 || eyes == Eyes::kLeft);
    }
  };
  [[nodiscard]] static int nearest(std::span<const Marker> markers, const std::array<int64_t, 2>& place_q8,
                                   int64_t gate_q8);
  [[nodiscard]] static Shifts still_of(Gain m);
  [[nodiscard]] static bool is_contradicted(const Pin& pin, const Shifts& shift);
  void move(Pin& pin, std::span<const Marker> markers, Eyes eyes);
  bool find_middle();
  void sample();

  std::vector<Pin> pin_;
  std::vector<Vector> place_;  // g
  std::vector<int32_t> kernel_;
  std::vector<int32_t> features_;
  int n_contradicted_ = 0;
  int64_t gate_q8_ = 0;    // of a pin at rest from its calibrated position
  int64_t min_press_ = 0;  // smallest -n . u of a touch
  Vector middle_ = Vector::Zero();
  Matrix turn_ = Matrix::Zero();
};

}  // namespace ruffini
