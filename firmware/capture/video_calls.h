// The system calls of a V4L2 device, and the video nodes of this computer: the seam behind which tests play a driver.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace ruffini {

// A node of /dev/video*, as sysfs describes it without opening it.
struct VideoNode {
  std::string path;
  std::string name;    // of the driver's: for USB the product's
  std::string serial;  // of the USB device; empty where it has none
  int vendor = 0;      // USB identity; 0: not on USB
  int product = 0;
};

// Each behaves as the call of its name, -1 and errno on failure; a call that a signal interrupts is made again.
struct VideoCalls {
  std::function<std::vector<VideoNode>()> nodes;
  std::function<int(const std::string& path)> open;  // O_RDWR | O_NONBLOCK
  std::function<int(int fd)> close;
  std::function<int(int fd, unsigned long request, void* argument)> ioctl;
  std::function<uint8_t*(int fd, size_t n_bytes, int64_t offset)> map;  // nullptr on failure
  std::function<void(uint8_t* data, size_t n_bytes)> unmap;
  // revents of POLLIN and POLLPRI; 0: nothing within the time.
  std::function<int(int fd, std::chrono::milliseconds longest)> poll;
  std::function<std::chrono::steady_clock::time_point()> now;

  // Of the kernel. `sysfs` is /sys/class/video4linux but in tests.
  [[nodiscard]] static VideoCalls of_kernel(const std::string& sysfs = "/sys/class/video4linux");
};

}  // namespace ruffini
