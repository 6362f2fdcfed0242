#include "image/difference_neon.h"
#include "image/dot_sums_neon.h"
#include "image/dot_tile_lanes.h"
#include "image/dot_weights_neon.h"
#include "image/glow_neon.h"
#include "image/kernels.h"
#include "image/lanes_neon.h"
#include "image/lanes_scalar.h"
#include "image/photometric_cells.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kNeon = {.difference = difference_row_neon,
                       .dots = {.weigh = DotWeightsNeon::run, .tiles = DotTileLanes<NeonLanes>::kernels()},
                       .dot_sums = dot_sums_neon,
                       .glow = glow_row_neon,
                       .smooth = smooth_line_neon,
                       .cells = PhotometricCells<NeonLanes>::run,
                       .poisson = PoissonSteps<NeonLanes>::run};

}  // namespace ruffini::kernels
