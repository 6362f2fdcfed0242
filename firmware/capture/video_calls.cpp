#include "capture/video_calls.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <system_error>

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// First line of a file; empty if there is none.
std::string line_of(const fs::path& path) {
  std::ifstream stream(path);
  std::string line;
  std::getline(stream, line);
  return line;
}

int hexadecimal(const std::string& text) {
  int number = 0;
  std::from_chars(text.data(), text.data() + text.size(), number, 16);
  return number;
}

std::vector<VideoNode> nodes_in(const fs::path& sysfs) {
  std::vector<VideoNode> nodes;
  std::error_code failed;
  for (const fs::directory_entry& entry : fs::directory_iterator(sysfs, failed)) {
    const std::string file = entry.path().filename().string();
    if (file.rfind("video", 0) != 0) continue;  // radio, v4l-subdev, vbi
    VideoNode node{.path = "/dev/" + file, .name = line_of(entry.path() / "name"), .serial = {}};
    // For a USB camera `device` is an interface of the device that has the identity.
    const fs::path interface = fs::canonical(entry.path() / "device", failed);
    const fs::path usb = interface.parent_path();
    if (!failed && fs::exists(usb / "idVendor", failed)) {
      node.serial = line_of(usb / "serial");
      node.vendor = hexadecimal(line_of(usb / "idVendor"));
      node.product = hexadecimal(line_of(usb / "idProduct"));
    }
    nodes.push_back(std::move(node));
  }
  // Sorts video2 before video10.
  std::sort(nodes.begin(), nodes.end(), [](const VideoNode& a, const VideoNode& b) {
    return a.path.size() != b.path.size() ? a.path.size() < b.path.size() : a.path < b.path;
  });
  return nodes;
}

template <typename Call>
auto uninterrupted(Call call) {
  auto result = call();
  while (result == -1 && errno == EINTR) result = call();
  return result;
}

}  // namespace

VideoCalls VideoCalls::of_kernel(const std::string& sysfs) {
  VideoCalls calls;
  calls.nodes = [sysfs] { return nodes_in(sysfs); };
  calls.open = [](const std::string& path) {
    return uninterrupted([&] { return ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC); });
  };
  calls.close = [](int fd) { return ::close(fd); };
  calls.ioctl = [](int fd, unsigned long request, void* argument) {
    return uninterrupted([&] { return ::ioctl(fd, request, argument); });
  };
  calls.map = [](int fd, size_t n_bytes, int64_t offset) -> uint8_t* {
    void* data = ::mmap(nullptr, n_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, offset);
    return data == MAP_FAILED ? nullptr : static_cast<uint8_t*>(data);
  };
  calls.unmap = [](uint8_t* data, size_t n_bytes) { ::munmap(data, n_bytes); };
  calls.poll = [](int fd, std::chrono::milliseconds longest) {
    pollfd one{fd, POLLIN | POLLPRI, 0};
    const int n = ::poll(&one, 1, static_cast<int>(longest.count()));
    if (n < 0) return errno == EINTR ? 0 : -1;
    return n == 0 ? 0 : static_cast<int>(one.revents);
  };
  calls.now = [] { return std::chrono::steady_clock::now(); };
  return calls;
}

}  // namespace ruffini
