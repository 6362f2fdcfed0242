// Detects a moved camera and an altered curve of grey levels from the edges of a glowing skin's openings. Touches
// change how bright openings are, not where their edges lie, nor how an edge's level compares with the opening's.
//
//   sample   strongest gradient g of base in a block of 8 x 8 pixels, central differences, above kMinGradient
//   r        light base - glow, clamped to +-|g|        light: image/taxels.h; glow, base: image/glow.h
//   sector   of the picture: right, left, below, above the principal point; d = (sum g g^T)^-1 sum g r, px
//   edge     median over cells of 64 x 64 pixels of (sum of glow / sum of base) over the cell's samples
//
//   moved       |d_x| or |d_y| > 0.2 px in any sector
//   off curve   |edge - light| > 0.8 %
//
// A change of all light by the same share, as by warming panels, changes neither. On the twin, touches of up to 33 N
// cause d of at most 0.02 px and edge - light of 0 to 0.3 %; a turn of 0.1 degrees causes d of 0.1 px. edge - light is
// -1.4 % at a gamma of 1.035 and 2.3 % at 0.97. Limits: sectors with fewer than kMinSamples samples, pictures with
// fewer than kMinCells cells. Not in the paper. Frame thread; no allocation after the constructor but in learn().
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "board/settings.h"

namespace ruffini {

class OpeningEdges {
 public:
  struct Defects {
    bool has_moved = false;
    bool is_off_curve = false;
  };

  explicit OpeningEdges(const CameraSettings& camera);

  // Brightness of the untouched picture.
  void learn(std::span<const int16_t> base);
  // `glow`: above base. `light_q12`: of the skin relative to rest, minus 1.
  [[nodiscard]] Defects run(std::span<const int16_t> glow, int64_t light_q12);

 private:
  static constexpr size_t kSectors = 4;

  struct Sample {
    uint32_t pixel = 0;
    int32_t base = 0;
    int32_t twice_x = 0;  // 2 g
    int32_t twice_y = 0;
    int32_t limit = 0;  // |g|
    uint32_t sector = 0;
    uint32_t cell = 0;
  };
  struct Sector {
    int64_t xx = 0;  // of (2 g) (2 g)^T, shifted right by `shift`
    int64_t xy = 0;
    int64_t yy = 0;
    int shift = 0;
    bool is_known = false;
  };
  struct Cell {
    int64_t glow = 0;
    int64_t base = 0;  // 0: fewer than kMinInCell samples
  };

  struct Run {
    uint32_t first = 0;
    uint32_t end = 0;
  };

  void add_block(std::span<const int16_t> base, int left, int top);

  CameraSettings camera_;
  int n_cells_x_;
  std::vector<Sample> samples_;  // by sector and cell
  std::vector<Run> runs_;        // of samples of one cell in one sector
  std::array<Sector, kSectors> sectors_{};
  std::vector<Cell> cells_;
  std::vector<int32_t> sorted_;
};

}  // namespace ruffini
