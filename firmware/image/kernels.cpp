#include "image/kernels.h"

namespace ruffini::kernels {

const Kernels& fastest_supported() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx2") ? kAvx2 : kScalar;
#elif defined(__aarch64__)
  return kNeon;
#else
  return kScalar;
#endif
}

}  // namespace ruffini::kernels
