// Tables of the taxels of a skin, from kind `skin` of proto/CALIBRATION.md. Not in the paper.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "store/calibration.h"

namespace ruffini {

struct TaxelTables {
  static constexpr int kStep = 64;            // step of ratio (image/taxels.h) between two values of `sink` and `press`
  static constexpr int kSize = 577;           // from -1 to 8 times the light at rest
  static constexpr size_t kNeighbours = 8;    // left, right, up, down, then the diagonals
  static constexpr size_t kCoefficients = 4;  // of a polynomial of the third degree
  static constexpr size_t kLeans = 9;         // of the gain, over |q| along an axis: 0 to 1
  static constexpr std::array<int64_t, 6> kLoadsUn = {500'000,   1'000'000, 2'000'000,  // of the gain, over the elastic
                                                      4'000'000, 8'000'000, 16'000'000};  // force; held beyond

  struct Taxel {
    int64_t x_um = 0;
    int64_t y_um = 0;
    size_t kind = 0;                                            // selects its gain and its deviations
    std::array<int16_t, kNeighbours> near{};                    // -1: none
    std::array<std::array<int64_t, kCoefficients>, 2> shift{};  // um Q8, of 1, q, q^2, q^3; along x and y
  };

  // Standard deviations of touches on a kind of taxels; of the position also an addition at the contact threshold, which
  // falls as the force rises.
  struct Sigma {
    int64_t force_un = 0;   // a constant
    int64_t force_q12 = 0;  // a share of the force
    int64_t place_um = 0;
    int64_t faint_place_um = 0;
  };

  [[nodiscard]] static Result<TaxelTables> load(const Calibration& calibration, const BoardSettings& board);

  // Returns an offset along x, wrapped around a tube.
  [[nodiscard]] int64_t wrapped_um(int64_t dx_um) const;
  // Response at this offset to a touch of unit strength, Q14; 0 beyond the table.
  [[nodiscard]] int64_t reach_q14(int64_t dx_um, int64_t dy_um) const;
  // Ratio of real to elastic force for a touch with lean |q| Q12 (taxel_touches.h), linear in all three inputs.
  [[nodiscard]] int64_t gain_of(size_t kind, int64_t elastic_un, const std::array<int64_t, 2>& lean_q12) const;

  std::vector<Taxel> taxels;
  std::vector<int32_t> gain_q16;   // of force: [kind][load][lean along y][lean along x]
  std::vector<int32_t> sink_q12;   // indentation of a taxel, in any unit, over its ratio
  std::vector<int32_t> press_lsb;  // its elastic force in force steps, over its ratio
  std::vector<int16_t> reach;      // [y][x], by offset
  GridSize reach_size;
  int64_t reach_step_um = 0;
  int64_t round_um = 0;  // circumference of a tube, else 0
  int64_t taxel_area_um2 = 0;
  int64_t floor_q12 = 0;       // a taxel with less sink is not touched
  int64_t apart_q12 = 0;       // unexplained sink over own sink that indicates another touch
  int64_t pair_q12 = 0;        // improvement by two positions over one that indicates two touches (touch_pair.h)
  std::vector<Sigma> sigma;    // by kind
  int64_t stray_limit_q6 = 0;  // outside light
};

}  // namespace ruffini
