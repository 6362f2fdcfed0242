// Drift of the lamps over the picture: a polynomial of order four per channel, in addition to the gain of
// image/light.h.
//
//   q_k = products of Legendre polynomials of x and y, of total order <= 4, made orthogonal over the usable samples
//   window:  16 frames, without overlap; touched if a marker was off its rest in any of them
//   r = mean of a sample over the window, relative to the map in force
//   fit:     median + sum(a_k q_k), three rounds of a_k += sum(e q_k) / sum(q_k^2); e = r - fit, clamped to +-1.5 % in
//            the first round, then zero where beyond 0.5 %
//   smooth   means: at most 1/32 of the samples are more than 1 % off the fit in any channel
//   if smooth, not touched and, without markers, not far (below):
//            c_k += s_k = clamp(a_k / 4, +-2^-12); the rate v_k += (s_k - v_k) / 64 unless s_k was clamped
//   else:    c_k += v_k, v_k -= v_k / 256: the lamps go on as before the contact
//
// A contact has edges that no polynomial of order four can follow: the samples that it shades are excluded from the
// fit, and if they are more than a 32nd of all samples, the window is not smooth. The constant term is the gain of
// image/light.h: s_0 is added only while light.h does not change it.
//
// `is_wrong`, any of:
//   far       a smooth fit deviates by more than 0.4 % from its mean somewhere in the picture. With markers at rest the
//             map follows, and the flag ends once it has. Without markers the change could be a large smooth object: it
//             is not followed, and the flag stays, also while a press has edges, until the light returns or rest is
//             learned again.
//   unlike    markers are at rest, the change is not smooth, and its fit deviates by more than 1 % from its mean: a
//             failed lamp or a shadow.
//   at limit  the last window that was followed took a coefficient beyond +-1/8, where it is clamped.
//   stale     the extrapolation since the last window that was followed exceeds 1 % in a term.
//
// At 60 Hz the map follows 0.09 % a second in each term. Frame thread; no allocation after the constructor. Not in the
// papers.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "image/rest.h"

namespace ruffini {

// State of the pad by its markers; a window has the state of its worst frame.
enum class PadState : uint8_t { kTouched, kUnknown, kAtRest };  // unknown: no marker is visible

class LightMap {
 public:
  static constexpr size_t kTerms = 15;
  static constexpr int kWindowFrames = 16;
  static constexpr size_t kMaxSamples = 640;            // of the picture's, evenly chosen
  static constexpr size_t kMinSamples = 200;            // fewer: no map, since noise alone would make a fit "far"
  using Samples = std::array<std::vector<int16_t>, 3>;  // per channel, Q12

  LightMap(int width_px, int height_px);

  // A new rest image is in force. `sample_at`: first pixel of each sample (image/light.h).
  void learn(std::span<const int32_t> sample_at);
  // Takes one frame. `gain`: that of image/light.h; changed here only if light.h does not follow it. True if the
  // map has changed by more than 1/2048 somewhere since run() last returned true.
  [[nodiscard]] bool run(const Samples& sample, PadState pad, bool is_gain_followed, Rest::Gain& gain);

  // Factor on the gain at the nodes of Rest::set_map, Q20.
  [[nodiscard]] std::span<const int32_t> factor() const { return factor_; }
  [[nodiscard]] bool is_wrong() const { return is_unmatched_ || is_at_limit_ || is_stale_; }

 private:
  using Terms = std::array<int64_t, kTerms>;
  void orthogonalise(size_t term);
  void fit(size_t channel, Terms& a);
  void end_window(bool is_gain_followed, Rest::Gain& gain);
  void follow(const std::array<Terms, 3>& a, bool is_gain_followed, Rest::Gain& gain);
  void extrapolate(Rest::Gain& gain);
  void make_factors();
  [[nodiscard]] std::span<int16_t> basis(size_t term);  // at the samples, then at the nodes, Q12

  int width_px_;
  int height_px_;
  GridSize nodes_;
  size_t term_size_;            // values of a term: samples, then nodes
  std::vector<size_t> sample_;  // which of the samples are used
  std::vector<int16_t> basis_;
  Terms square_{};  // sum of q_k^2 over the samples, Q24; 0: the samples do not determine this term
  size_t n_samples_ = 0;

  int n_frames_ = 0;  // of this window
  PadState pad_ = PadState::kAtRest;
  std::array<std::vector<int32_t>, 3> sum_;  // of the samples over the window: Q16 of their mean when it ends
  std::vector<int32_t> fitted_;              // Q16
  std::vector<int32_t> sorted_;
  std::vector<uint8_t> is_out_;
  int64_t farthest_q16_ = 0;  // of the shapes fitted in this window

  std::array<Terms, 3> coefficient_{};   // Q24; the constant term is 0
  std::array<Terms, 3> rate_{};          // a window, Q32
  std::array<Terms, 3> extrapolated_{};  // since the last window that was followed, Q32
  Rest::Gain gain_before_ = Rest::unit_gain();
  std::vector<int32_t> factor_;    // planes of B, G and R
  std::vector<int32_t> in_force_;  // values when run() last returned true
  bool is_unmatched_ = false;
  bool is_at_limit_ = false;
  bool is_stale_ = false;
};

}  // namespace ruffini
