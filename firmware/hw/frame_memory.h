// Memory that a camera writes and the processor reads: from a DMA heap if the kernel has one, else a memfd.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/result.h"
#include "base/unique_fd.h"

namespace ruffini {

struct FrameMemory {
  UniqueFd fd;
  bool is_dma = false;  // otherwise only software cameras can write it
};

// `heaps`: folder of the kernel's heaps. Takes the first heap that provides memory, cached heaps first. Errors:
// kUnavailable if even a memfd is impossible.
[[nodiscard]] Result<FrameMemory> allocate_frame_memory(size_t n_bytes, const char* heaps = "/dev/dma_heap");

// Maps the memory of `fd` for reading and unmaps it in the destructor.
class FrameMapping {
 public:
  FrameMapping() = default;
  FrameMapping(int fd, size_t n_bytes);
  FrameMapping(FrameMapping&& other) noexcept;
  FrameMapping& operator=(FrameMapping&&) = delete;
  FrameMapping(const FrameMapping&) = delete;
  ~FrameMapping();

  // Returns nullptr if it could not be mapped.
  [[nodiscard]] const uint8_t* data() const { return data_; }
  // Makes the camera's data visible / allows the camera to write again. No effect for memory that is not a DMA buffer.
  void begin_read() const;
  void end_read() const;

 private:
  int fd_ = -1;
  size_t n_bytes_ = 0;
  const uint8_t* data_ = nullptr;
};

}  // namespace ruffini
