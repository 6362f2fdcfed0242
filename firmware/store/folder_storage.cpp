#include "store/folder_storage.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <utility>

#include "store/huge_pages.h"

namespace ruffini {
namespace {

constexpr size_t kMaxFileBytes = size_t{256} << 20;

Error storage_error(const std::string& what, const std::string& path) {
  return {ErrorKind::kStorage, path + ": cannot " + what + ": " + std::strerror(errno) +
                                   ": check the medium, its space and the permissions"};
}

class WrittenFile final : public NewFile {
 public:
  WrittenFile(UniqueFd fd, std::string path) : fd_(std::move(fd)), path_(std::move(path)) {}

  Status write(std::span<const uint8_t> bytes) override {
    while (!bytes.empty()) {
      const ssize_t n = ::write(fd_.get(), bytes.data(), bytes.size());
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return storage_error("write", path_);
      bytes = bytes.subspan(static_cast<size_t>(n));
    }
    return Unit{};
  }
  Status sync() override {
    if (::fsync(fd_.get()) != 0) return storage_error("sync", path_);
    return Unit{};
  }

 private:
  UniqueFd fd_;
  std::string path_;
};

// Reads an open file completely. Its type and size come from the same descriptor, so they cannot change in between.
Result<std::vector<uint8_t>> read_whole(const UniqueFd& file, const std::string& path, ReadFrom from) {
  struct stat status{};
  if (::fstat(file.get(), &status) != 0) return storage_error("stat", path);
  if (!S_ISREG(status.st_mode) || static_cast<size_t>(status.st_size) > kMaxFileBytes) {
    errno = EFBIG;
    return storage_error("use (not a plain file, or too large)", path);
  }
  if (from == ReadFrom::kMedium) ::posix_fadvise(file.get(), 0, 0, POSIX_FADV_DONTNEED);
  std::vector<uint8_t> bytes = bytes_in_huge_pages(static_cast<size_t>(status.st_size));
  for (size_t at = 0; at < bytes.size();) {
    const ssize_t n = ::read(file.get(), bytes.data() + at, bytes.size() - at);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return storage_error("read", path);
    at += static_cast<size_t>(n);
  }
  return bytes;
}

}  // namespace

Result<std::vector<uint8_t>> read_file(const std::string& path) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!file) return storage_error("open", path);
  return read_whole(file, path, ReadFrom::kAnywhere);
}

Result<std::unique_ptr<Storage>> FolderStorage::open(const std::string& folder) {
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  UniqueFd fd(failed ? -1 : ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd) {
    if (failed) errno = failed.value();
    return storage_error("use as a calibration store", folder);
  }
  return std::unique_ptr<Storage>(new FolderStorage(folder, std::move(fd)));
}

Result<std::vector<std::string>> FolderStorage::list() const {
  const int again = ::openat(fd_.get(), ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  DIR* entries = again < 0 ? nullptr : ::fdopendir(again);
  if (entries == nullptr) return storage_error("list", folder_);
  std::vector<std::string> names;
  errno = 0;
  while (const dirent* entry = ::readdir(entries)) names.emplace_back(entry->d_name);
  const int failed = errno;
  ::closedir(entries);
  errno = failed;
  if (failed != 0) return storage_error("list", folder_);
  return names;
}

Result<std::vector<uint8_t>> FolderStorage::read(const std::string& name, ReadFrom from) const {
  const UniqueFd file(::openat(fd_.get(), name.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (!file) return storage_error("open", path(name));
  return read_whole(file, path(name), from);
}

Result<std::unique_ptr<NewFile>> FolderStorage::create(const std::string& name, size_t n_bytes) {
  UniqueFd file(::openat(fd_.get(), name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file) return storage_error("create", path(name));
  // Allocates first: a full medium is detected before the first byte, and no write can run out of space.
  const int failed = n_bytes == 0 ? 0 : ::posix_fallocate(file.get(), 0, static_cast<off_t>(n_bytes));
  if (failed != 0) {
    ::unlinkat(fd_.get(), name.c_str(), 0);
    errno = failed;
    return storage_error("reserve " + std::to_string(n_bytes) + " bytes", path(name));
  }
  return std::unique_ptr<NewFile>(std::make_unique<WrittenFile>(std::move(file), path(name)));
}

Status FolderStorage::rename(const std::string& from, const std::string& to) {
  if (::renameat(fd_.get(), from.c_str(), fd_.get(), to.c_str()) != 0) return storage_error("rename to", path(to));
  return Unit{};
}

Status FolderStorage::remove(const std::string& name) {
  if (::unlinkat(fd_.get(), name.c_str(), 0) != 0) return storage_error("remove", path(name));
  return Unit{};
}

Status FolderStorage::can_write() const {
  if (::faccessat(fd_.get(), ".", W_OK | X_OK, 0) != 0) return storage_error("write there", folder_);
  return Unit{};
}

Status FolderStorage::sync_folder() {
  if (::fsync(fd_.get()) != 0) return storage_error("sync", folder_);
  return Unit{};
}

}  // namespace ruffini
