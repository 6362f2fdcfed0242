#include "image/kernels.h"
#include "image/lanes_scalar.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kScalar = {PoissonSteps<ScalarLanes>::run};

}  // namespace ruffini::kernels
