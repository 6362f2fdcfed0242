#include "hw/frame_memory.h"

#include <fcntl.h>
#include <linux/dma-buf.h>
#include <linux/dma-heap.h>
#include <sys/ioctl.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

namespace ruffini {
namespace {

// vidbuf_cached and linux,cma: physically contiguous, as the Raspberry Pi's camera needs; system: pages.
constexpr const char* kHeaps[] = {"vidbuf_cached", "linux,cma", "reserved", "default_cma_region", "system"};

UniqueFd from_heap(const std::string& path, size_t n_bytes) {
  const UniqueFd heap(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!heap) return {};
  dma_heap_allocation_data wanted{};
  wanted.len = n_bytes;
  wanted.fd_flags = O_RDWR | O_CLOEXEC;
  if (::ioctl(heap.get(), DMA_HEAP_IOCTL_ALLOC, &wanted) != 0) return {};
  return UniqueFd(static_cast<int>(wanted.fd));
}

void sync(int fd, uint64_t flags) {
  const dma_buf_sync step{flags | DMA_BUF_SYNC_READ};
  // A signal may interrupt the call; memory that is not a DMA buffer gives ENOTTY.
  while (::ioctl(fd, DMA_BUF_IOCTL_SYNC, &step) != 0 && errno == EINTR) {
  }
}

}  // namespace

Result<FrameMemory> allocate_frame_memory(size_t n_bytes, const char* heaps) {
  for (const char* name : kHeaps) {
    UniqueFd fd = from_heap(std::string(heaps) + "/" + name, n_bytes);
    if (fd) return FrameMemory{std::move(fd), true};
  }
  UniqueFd fd(::memfd_create("ruffini-frame", MFD_CLOEXEC));
  if (!fd || ::ftruncate(fd.get(), static_cast<off_t>(n_bytes)) != 0) {
    return Error{ErrorKind::kUnavailable,
                 std::to_string(n_bytes) + " bytes of frame memory: " + std::strerror(errno) + ": is memory free?"};
  }
  return FrameMemory{std::move(fd), false};
}

FrameMapping::FrameMapping(int fd, size_t n_bytes) : fd_(fd), n_bytes_(n_bytes) {
  void* mapped = ::mmap(nullptr, n_bytes, PROT_READ, MAP_SHARED, fd, 0);
  if (mapped != MAP_FAILED) data_ = static_cast<const uint8_t*>(mapped);
}

FrameMapping::FrameMapping(FrameMapping&& other) noexcept
    : fd_(other.fd_), n_bytes_(other.n_bytes_), data_(std::exchange(other.data_, nullptr)) {}

FrameMapping::~FrameMapping() {
  if (data_ != nullptr) ::munmap(const_cast<uint8_t*>(data_), n_bytes_);
}

void FrameMapping::begin_read() const { sync(fd_, DMA_BUF_SYNC_START); }
void FrameMapping::end_read() const { sync(fd_, DMA_BUF_SYNC_END); }

}  // namespace ruffini
