// Memory for tables that every frame reads as a whole. With pages of 4 kB the processor looks up more of them than it
// remembers, and its prefetching stops at each: the dense pad's operator then takes 1.7 times as long.
#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace ruffini {

// `n` zeros, in large pages where the kernel has some and they pay. A hint: without them all works the same.
inline std::vector<uint8_t> bytes_in_huge_pages(size_t n) {
  constexpr size_t kWorth = size_t{4} << 20;
  std::vector<uint8_t> bytes;
  bytes.reserve(n);
  if (n >= kWorth) {  // before the first touch, which decides about the page
    const auto page = static_cast<uintptr_t>(::sysconf(_SC_PAGESIZE));
    const uintptr_t first = (reinterpret_cast<uintptr_t>(bytes.data()) + page - 1) / page * page;
    const uintptr_t end = (reinterpret_cast<uintptr_t>(bytes.data()) + n) / page * page;
    static_cast<void>(::madvise(reinterpret_cast<void*>(first), end - first, MADV_HUGEPAGE));
  }
  bytes.resize(n);
  return bytes;
}

}  // namespace ruffini
