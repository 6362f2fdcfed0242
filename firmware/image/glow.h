// Brightness that touches add to a glowing skin: weighted channels minus those of the untouched picture, smoothed.
//
//   base = (sum_c w_c rest + 2) >> 2      rest in 1/16 levels (image/rest.h)
//   glow = 4 sum_c w_c I - base           1/4 levels; w_c: [skin] weights, with a sum of 1 to 8: |glow| <= 8160
//   smooth: Gaussian of 2 px in 13 taps t_k, along y, then along x; border pixels are repeated
//     out = sum_k ((in[-k] + in[k]) t_k + 2^14) >> 15, the centre tap once; the taps' sum is 2^15
//
// The paper describes "frame difference, green + blue, smoothing filter" without the filter's coefficients. Frame
// thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "board/settings.h"

namespace ruffini {

struct GlowRow {
  const uint8_t* pixels = nullptr;  // B, G, R interleaved
  int width = 0;
  std::array<int16_t, 3> weight{};
  const int16_t* base = nullptr;
  int16_t* glow = nullptr;
};
using GlowRun = void (*)(const GlowRow& row);

// The reference. Other versions call it for the remaining pixels of a row, from `first` on.
void glow_row_scalar(const GlowRow& row, int first);

inline constexpr int kSmoothReach = 6;  // px to either side: three standard deviations
// exp(-k^2 / 8) divided by its sum, Q15; the first one is adjusted to make the sum exact.
inline constexpr std::array<int16_t, kSmoothReach + 1> kSmoothTap = {6544, 5774, 3969, 2124, 885, 287, 73};
static_assert(kSmoothTap[0] +
                  2 * (kSmoothTap[1] + kSmoothTap[2] + kSmoothTap[3] + kSmoothTap[4] + kSmoothTap[5] + kSmoothTap[6]) ==
              1 << 15);

// Computes one line from 13 adjacent lines: rows of a picture, or one row shifted by a pixel each.
struct SmoothLine {
  std::array<const int16_t*, 2 * kSmoothReach + 1> in{};
  int width = 0;
  int16_t* out = nullptr;
};
using SmoothRun = void (*)(const SmoothLine& line);
void smooth_line_scalar(const SmoothLine& line, int first);

class Glow {
 public:
  explicit Glow(const BoardSettings& board);  // selects the fastest version that this processor supports
  Glow(const BoardSettings& board, GlowRun glow_run, SmoothRun smooth_run);

  // Sets the untouched image, width x height x 3 in 1/16 levels.
  void learn(std::span<const uint16_t> rest);
  void run(const FrameView& frame);
  void smooth();

  [[nodiscard]] std::span<const int16_t> base() const { return base_; }
  [[nodiscard]] std::span<const int16_t> plane() const { return glow_; }
  [[nodiscard]] std::span<const int16_t> smoothed() const { return smoothed_; }

 private:
  int width_px_;
  int height_px_;
  std::array<int16_t, 3> weight_;
  GlowRun glow_run_;
  SmoothRun smooth_run_;
  std::vector<int16_t> base_;
  std::vector<int16_t> glow_;
  std::vector<int16_t> smoothed_;
  std::vector<int16_t> line_;  // a row smoothed along y, with kSmoothReach more pixels at either end
};

}  // namespace ruffini
