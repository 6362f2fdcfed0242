#include "image/kernels.h"
#include "image/lanes_avx2.h"
#include "image/lanes_scalar.h"
#include "image/poisson_steps.h"

namespace ruffini::kernels {

const Kernels kAvx2 = {PoissonSteps<Avx2Lanes>::run};

}  // namespace ruffini::kernels
