#include "support/faulty_calls.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstddef>

namespace ruffini::test {
namespace {

Strike g_strike;
bool g_is_armed = false;
int g_n_calls = 0;

bool is_struck() {
  const bool is_it = g_n_calls == g_strike.at || (g_strike.is_forever && g_n_calls > g_strike.at);
  return g_strike.at > 0 && is_it;
}

// `call` as it is, or what the strike makes of it; `failed` is its return value then.
template <typename Call>
auto counted(Call call, decltype(call()) failed, bool is_writing = true) {
  if (!g_is_armed || (g_strike.is_of_writing && !is_writing)) return call();
  ++g_n_calls;
  if (is_struck() && g_strike.n_bytes < 0 && !g_strike.is_after) {
    if (g_strike.error == 0) g_strike.stop();
    errno = g_strike.error;
    return failed;
  }
  const auto result = call();
  if (is_struck() && g_strike.is_after && g_strike.error == 0) g_strike.stop();
  return result;
}

size_t shortened(size_t n_bytes) {
  // Called before counted() counts.
  const bool is_next = g_is_armed && g_strike.at > 0 && g_n_calls + 1 == g_strike.at;
  return is_next && g_strike.n_bytes >= 0 ? std::min(n_bytes, static_cast<size_t>(g_strike.n_bytes)) : n_bytes;
}

}  // namespace

void arm(const Strike& strike) {
  g_strike = strike;
  g_n_calls = 0;
  g_is_armed = true;
}

int disarm() {
  g_is_armed = false;
  return g_n_calls;
}

}  // namespace ruffini::test

using ruffini::test::counted;
using ruffini::test::g_is_armed;
using ruffini::test::g_strike;
using ruffini::test::shortened;

extern "C" {

int open(const char* path, int flags, ...) {
  va_list more;
  va_start(more, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(more, mode_t) : 0;
  va_end(more);
  return counted([&] { return static_cast<int>(::syscall(SYS_openat, AT_FDCWD, path, flags, mode)); }, -1,
                 (flags & O_CREAT) != 0);
}

int openat(int folder, const char* path, int flags, ...) {
  va_list more;
  va_start(more, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(more, mode_t) : 0;
  va_end(more);
  return counted([&] { return static_cast<int>(::syscall(SYS_openat, folder, path, flags, mode)); }, -1,
                 (flags & O_CREAT) != 0);
}

int faccessat(int folder, const char* path, int mode, int /*flags*/) noexcept {
  return counted([&] { return static_cast<int>(::syscall(SYS_faccessat, folder, path, mode)); }, -1);
}

ssize_t write(int fd, const void* bytes, size_t n) {
  const size_t some = shortened(n);
  return counted([&] { return static_cast<ssize_t>(::syscall(SYS_write, fd, bytes, some)); }, ssize_t{-1});
}

ssize_t read(int fd, void* bytes, size_t n) {
  const size_t some = shortened(n);
  return counted([&] { return static_cast<ssize_t>(::syscall(SYS_read, fd, bytes, some)); }, ssize_t{-1}, false);
}

int fsync(int fd) {
  return counted([&] { return g_is_armed && g_strike.has_no_sync ? 0 : static_cast<int>(::syscall(SYS_fsync, fd)); },
                 -1);
}

int posix_fallocate(int fd, off_t from, off_t n) {
  const int failed = counted([&] { return static_cast<int>(::syscall(SYS_fallocate, fd, 0, from, n)); }, -1);
  return failed == 0 ? 0 : errno;  // it does not set errno, it returns it
}

int renameat(int from_folder, const char* from, int to_folder, const char* to) noexcept {
  return counted([&] { return static_cast<int>(::syscall(SYS_renameat2, from_folder, from, to_folder, to, 0)); }, -1);
}

int unlinkat(int folder, const char* path, int flags) noexcept {
  return counted([&] { return static_cast<int>(::syscall(SYS_unlinkat, folder, path, flags)); }, -1);
}

int fstat(int fd, struct stat* status) noexcept {
  return counted([&] { return ::fstatat(fd, "", status, AT_EMPTY_PATH); }, -1, false);
}

}  // extern "C"
