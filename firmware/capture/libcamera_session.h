// One libcamera camera with its buffers and requests.
#pragma once

#include <libcamera/libcamera.h>

#include <array>
#include <condition_variable>
#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "hw/frame_memory.h"

namespace ruffini {

inline constexpr unsigned kRequests = 4;

// libcamera permits one manager per process, however many cameras are open; it stops with the last of them. Returns
// nullptr if it did not start.
[[nodiscard]] std::shared_ptr<libcamera::CameraManager> camera_manager();

// All libcamera objects of a camera, in one struct so that they can be abandoned together if a call does not return.
struct LibcameraSession {
  std::shared_ptr<libcamera::CameraManager> manager;
  std::shared_ptr<libcamera::Camera> camera;
  std::unique_ptr<libcamera::CameraConfiguration> configuration;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator;
  std::vector<std::unique_ptr<libcamera::FrameBuffer>> own_buffers;
  std::map<const libcamera::FrameBuffer*, FrameMapping> mappings;
  std::vector<std::unique_ptr<libcamera::Request>> requests;
  bool is_acquired = false;
  bool is_running = false;

  std::mutex mutex;  // guards the members below
  std::condition_variable changed;
  std::array<libcamera::Request*, kRequests> done{};
  size_t n_done = 0;
  bool is_gone = false;

  LibcameraSession() = default;
  LibcameraSession(const LibcameraSession&) = delete;
  LibcameraSession& operator=(const LibcameraSession&) = delete;
  ~LibcameraSession();

  // Frees the buffers of a stream that did not start.
  void free_buffers();

  // Called in libcamera's thread.
  void complete(libcamera::Request* request);
  void disconnect();
};

}  // namespace ruffini
