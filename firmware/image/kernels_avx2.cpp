#include "image/difference_avx2.h"
#include "image/dot_sums_avx2.h"
#include "image/dot_tile_lanes.h"
#include "image/dot_weights.h"
#include "image/glow_avx2.h"
#include "image/kernels.h"
#include "image/lanes_avx2.h"
#include "image/lanes_scalar.h"
#include "image/photometric_cells.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kAvx2 = {.difference = difference_row_avx2,
                       .dots = {.weigh = DotWeights<Avx2Lanes>::run, .tiles = DotTileLanes<Avx2Lanes>::kernels()},
                       .dot_sums = dot_sums_avx2,
                       .glow = glow_row_avx2,
                       .smooth = smooth_line_avx2,
                       .cells = PhotometricCells<Avx2Lanes>::run,
                       .poisson = PoissonSteps<Avx2Lanes>::run};

}  // namespace ruffini::kernels
