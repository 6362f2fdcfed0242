// One camera of libcamera with its buffers and requests.
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

// libcamera allows one manager in a process, however many cameras are open; it stops with the last of them.
// nullptr: it did not start.
[[nodiscard]] std::shared_ptr<libcamera::CameraManager> camera_manager();

// Everything of libcamera, so that it can be left alone as a whole where a call does not come back.
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

  std::mutex mutex;  // of what follows
  std::condition_variable changed;
  std::array<libcamera::Request*, kRequests> done{};
  size_t n_done = 0;
  bool is_gone = false;

  LibcameraSession() = default;
  LibcameraSession(const LibcameraSession&) = delete;
  LibcameraSession& operator=(const LibcameraSession&) = delete;
  ~LibcameraSession();

  // Of a stream that did not start.
  void let_buffers_go();

  // libcamera's thread.
  void complete(libcamera::Request* request);
  void disconnect();
};

}  // namespace ruffini
