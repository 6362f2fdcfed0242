#include "image/kernels.h"

#include "base/processor.h"

namespace ruffini::kernels {

const Kernels& fastest_supported() {
#if defined(__x86_64__)
  return has_avx2() ? kAvx2 : kScalar;
#elif defined(__aarch64__)
  return kNeon;
#else
  return kScalar;
#endif
}

}  // namespace ruffini::kernels
