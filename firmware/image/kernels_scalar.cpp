#include "image/dot_sums.h"
#include "image/dot_tile_lanes.h"
#include "image/dot_weights.h"
#include "image/kernels.h"
#include "image/lanes_scalar.h"
#include "image/photometric_cells.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kScalar = {.difference = [](const DifferenceRow& row) { return difference_row_scalar(row, 0); },
                         .dots = {.weigh = DotWeights<ScalarLanes>::run, .tiles = DotTileLanes<ScalarLanes>::kernels()},
                         .dot_sums = dot_sums_scalar,
                         .glow = [](const GlowRow& row) { glow_row_scalar(row, 0); },
                         .smooth = [](const SmoothLine& line) { smooth_line_scalar(line, 0); },
                         .cells = PhotometricCells<ScalarLanes>::run,
                         .poisson = PoissonSteps<ScalarLanes>::run};

}  // namespace ruffini::kernels
