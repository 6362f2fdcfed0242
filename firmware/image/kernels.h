// The inner loops of the image stages: written once on lanes (lanes_scalar.h), compiled for each processor, chosen
// at run time. All versions are equal bit for bit.
#pragma once

#include "image/difference.h"
#include "image/dots.h"
#include "image/glow.h"
#include "image/photometric.h"
#include "image/poisson.h"

namespace ruffini::kernels {

struct Kernels {
  DifferenceRun difference;
  DotRun dots;
  GlowRun glow;
  SmoothRun smooth;
  CellRun cells;
  PoissonRun poisson;
};

extern const Kernels kScalar;  // the reference
// Compiled where the target has them (SIMDe in tests).
extern const Kernels kAvx2;
extern const Kernels kNeon;

// The fastest that this processor runs.
const Kernels& best();

}  // namespace ruffini::kernels
