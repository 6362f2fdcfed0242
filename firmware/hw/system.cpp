#include "hw/system.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/stat.h>

#include <bit>
#include <cerrno>
#include <chrono>
#include <cstdlib>

#include "base/unique_fd.h"

namespace ruffini {

uint64_t SystemClock::now_us() const {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

static_assert(std::endian::native == std::endian::little, "the file's number is read as it is");
static_assert(sizeof(std::atomic<uint64_t>) == 8 && std::atomic<uint64_t>::is_always_lock_free);

Result<std::unique_ptr<Clock>> FileClock::open(const std::string& path) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat there{};
  void* mapped = MAP_FAILED;
  if (file && ::fstat(file.get(), &there) == 0 && there.st_size >= static_cast<off_t>(sizeof(uint64_t))) {
    mapped = ::mmap(nullptr, sizeof(uint64_t), PROT_READ, MAP_SHARED, file.get(), 0);
  }
  if (mapped == MAP_FAILED) {
    return Error{ErrorKind::kUnavailable, path + ": cannot be read as a clock: give a file of 8 bytes"};
  }
  return std::unique_ptr<Clock>(new FileClock(static_cast<const std::atomic<uint64_t>*>(mapped)));
}

FileClock::~FileClock() { ::munmap(const_cast<std::atomic<uint64_t>*>(word_), sizeof(uint64_t)); }

void SystemRandom::fill(std::span<uint8_t> out) {
  while (!out.empty()) {
    const ssize_t n = ::getrandom(out.data(), out.size(), 0);
    if (n > 0) {
      out = out.subspan(static_cast<size_t>(n));
    } else if (errno != EINTR) {
      std::abort();  // a kernel without it: no later result could be trusted
    }
  }
}

}  // namespace ruffini
