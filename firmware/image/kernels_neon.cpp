#include "image/kernels.h"
#include "image/lanes_neon.h"
#include "image/lanes_scalar.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kNeon = {PoissonSteps<NeonLanes>::run};

}  // namespace ruffini::kernels
