// System calls on a V4L2 device, and the video nodes of this computer. Tests replace them to simulate a driver.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace ruffini {

// A /dev/video* node as described by sysfs, without opening it.
struct VideoNode {
  std::string path;
  std::string name;    // reported by the driver: for USB the product name
  std::string serial;  // of the USB device; empty if it has none
  int vendor = 0;      // USB identity; 0: not on USB
  int product = 0;
};

// Each function behaves like the system call of its name: -1 and errno on failure. Interrupted calls are repeated.
struct VideoCalls {
  std::function<std::vector<VideoNode>()> nodes;
  std::function<int(const std::string& path)> open;  // O_RDWR | O_NONBLOCK
  std::function<int(int fd)> close;
  std::function<int(int fd, unsigned long request, void* argument)> ioctl;
  std::function<uint8_t*(int fd, size_t n_bytes, int64_t offset)> map;  // nullptr on failure
  std::function<void(uint8_t* data, size_t n_bytes)> unmap;
  // Returns revents of POLLIN and POLLPRI; 0: nothing within the time.
  std::function<int(int fd, std::chrono::milliseconds longest)> poll;
  std::function<std::chrono::steady_clock::time_point()> now;

  // The kernel's calls. `sysfs` differs from /sys/class/video4linux only in tests.
  [[nodiscard]] static VideoCalls of_kernel(const std::string& sysfs = "/sys/class/video4linux");
};

}  // namespace ruffini
