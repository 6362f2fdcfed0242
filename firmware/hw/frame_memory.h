// Memory that a camera writes and the processor reads: a DMA heap's where the kernel has one, else a memfd.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/result.h"
#include "base/unique_fd.h"

namespace ruffini {

struct FrameMemory {
  UniqueFd fd;
  bool is_dma = false;  // else only a camera that is a program can write it
};

// `heaps`: the folder of the kernel's heaps; the first of them that gives memory is taken, cached ones before others.
// Errors: kUnavailable where not even a memfd can be had.
[[nodiscard]] Result<FrameMemory> allocate_frame_memory(size_t n_bytes, const char* heaps = "/dev/dma_heap");

// The memory of `fd`, mapped for reading; unmapped at the end.
class FrameMapping {
 public:
  FrameMapping() = default;
  FrameMapping(int fd, size_t n_bytes);
  FrameMapping(FrameMapping&& other) noexcept;
  FrameMapping& operator=(FrameMapping&&) = delete;
  FrameMapping(const FrameMapping&) = delete;
  ~FrameMapping();

  // nullptr: it could not be mapped.
  [[nodiscard]] const uint8_t* data() const { return data_; }
  // What the camera wrote becomes visible / the camera may write again. Nothing to do for memory that is no DMA buffer.
  void begin_read() const;
  void end_read() const;

 private:
  int fd_ = -1;
  size_t n_bytes_ = 0;
  const uint8_t* data_ = nullptr;
};

}  // namespace ruffini
