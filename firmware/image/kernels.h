// Inner loops of the image stages: written once on lanes (lanes_scalar.h), compiled for each instruction set, selected
// at run time. All versions are bit-identical.
#pragma once

#include "image/difference.h"
#include "image/dot_sums.h"
#include "image/dots.h"
#include "image/glow.h"
#include "image/photometric.h"
#include "image/poisson.h"

namespace ruffini::kernels {

struct Kernels {
  DifferenceRun difference;
  DotKernels dots;
  DotSumsRun dot_sums;
  GlowRun glow;
  SmoothRun smooth;
  CellRun cells;
  PoissonRun poisson;
};

extern const Kernels kScalar;  // the reference
// Compiled for targets that have these instructions, and by SIMDe in tests.
extern const Kernels kAvx2;
extern const Kernels kNeon;

// Returns the fastest version that this processor supports.
const Kernels& fastest_supported();

}  // namespace ruffini::kernels
