// What this processor has beside what every one of its kind has.
#pragma once

#if defined(__x86_64__)
#include <cpuid.h>
#endif

namespace ruffini {

#if defined(__x86_64__)
// Not __builtin_cpu_supports: zig's run time always denies.
[[nodiscard]] inline bool ask_for_avx2() {
  constexpr unsigned kSavesYmm = 6;
  unsigned a = 0;
  unsigned b = 0;
  unsigned c = 0;
  unsigned d = 0;
  if (__get_cpuid(1, &a, &b, &c, &d) == 0 || (c & bit_OSXSAVE) == 0) return false;
  asm("xgetbv" : "=a"(a), "=d"(d) : "c"(0));
  if ((a & kSavesYmm) != kSavesYmm) return false;
  return __get_cpuid_count(7, 0, &a, &b, &c, &d) != 0 && (b & bit_AVX2) != 0;
}

// True if this processor has AVX2 and the system keeps its registers. Asked once, not in each frame: a virtual machine
// traps CPUID (24 us each time, measured under KVM).
[[nodiscard]] inline bool has_avx2() {
  static const bool kHas = ask_for_avx2();
  return kHas;
}
#endif

}  // namespace ruffini
