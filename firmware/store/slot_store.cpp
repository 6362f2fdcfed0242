#include "store/slot_store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

constexpr char kActive[] = "calibration.safetensors";
constexpr char kPrevious[] = "previous.safetensors";
constexpr char kIncoming[] = "incoming.tmp";
constexpr size_t kMaxFileBytes = size_t{256} << 20;

Error storage_error(const std::string& what, const std::string& path) {
  return {ErrorKind::kStorage, path + ": cannot " + what + ": " + std::strerror(errno) +
                                   ": check the medium, its space and the permissions"};
}

// The whole file, refusing what is not a plain file.
Result<std::vector<uint8_t>> read_all(const std::string& path, bool from_medium) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  if (!file) return storage_error("open", path);
  struct stat status{};
  if (::fstat(file.get(), &status) != 0) return storage_error("stat", path);
  if (!S_ISREG(status.st_mode) || static_cast<size_t>(status.st_size) > kMaxFileBytes) {
    errno = EFBIG;
    return storage_error("use (not a plain file, or too large)", path);
  }
  if (from_medium) ::posix_fadvise(file.get(), 0, 0, POSIX_FADV_DONTNEED);
  std::vector<uint8_t> bytes(static_cast<size_t>(status.st_size));
  for (size_t at = 0; at < bytes.size();) {
    const ssize_t n = ::read(file.get(), bytes.data() + at, bytes.size() - at);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return storage_error("read", path);
    at += static_cast<size_t>(n);
  }
  return bytes;
}

Status write_all(const std::string& path, std::span<const uint8_t> bytes) {
  const UniqueFd file(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file) return storage_error("create", path);
  while (!bytes.empty()) {
    const ssize_t n = ::write(file.get(), bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return storage_error("write", path);
    bytes = bytes.subspan(static_cast<size_t>(n));
  }
  if (::fsync(file.get()) != 0) return storage_error("sync", path);
  return Unit{};
}

// Writes, and reads back from the medium what it kept.
Status write_checked(const std::string& path, std::span<const uint8_t> bytes) {
  Status written = write_all(path, bytes);
  if (!written) return written;
  const auto back = read_all(path, true);
  if (!back) return back.error();
  if (!std::equal(bytes.begin(), bytes.end(), back.value().begin(), back.value().end())) {
    errno = EIO;
    return storage_error("keep what was written to it (read-back differs)", path);
  }
  return Unit{};
}

}  // namespace

Result<SlotStore> SlotStore::open(const std::string& folder) {
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  if (failed || ::access(folder.c_str(), W_OK | X_OK) != 0) {
    if (failed) errno = failed.value();
    return storage_error("use as a calibration store", folder);
  }
  SlotStore store(folder);
  ::unlink(store.path(kIncoming).c_str());
  return store;
}

Result<std::vector<uint8_t>> SlotStore::load() const { return load(kActive); }

Result<std::vector<uint8_t>> SlotStore::load_previous() const { return load(kPrevious); }

Result<std::vector<uint8_t>> SlotStore::load(const char* name) const {
  const std::string file = path(name);
  if (::access(file.c_str(), F_OK) != 0 && errno == ENOENT) return std::vector<uint8_t>{};
  return read_all(file, false);
}

Status SlotStore::install(std::span<const uint8_t> bytes) const {
  const std::string incoming = path(kIncoming);
  ::unlink(incoming.c_str());
  const Status written = write_checked(incoming, bytes);
  const Status installed = written ? put_in_force(incoming) : written;
  if (!installed) ::unlink(incoming.c_str());
  return installed;
}

Status SlotStore::put_in_force(const std::string& incoming) const {
  const std::string active = path(kActive);
  const std::string previous = path(kPrevious);
  // The old file gets a second name first, so that there is one in force at every moment.
  ::unlink(previous.c_str());
  if (::link(active.c_str(), previous.c_str()) != 0 && errno != ENOENT) return storage_error("keep", previous);
  if (::rename(incoming.c_str(), active.c_str()) != 0) return storage_error("rename to", active);
  const UniqueFd folder(::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!folder || ::fsync(folder.get()) != 0) return storage_error("sync", folder_);
  return Unit{};
}

}  // namespace ruffini
