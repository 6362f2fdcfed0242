#include "hw/output_line.h"

#include <fcntl.h>
#include <linux/gpio.h>
#include <sys/ioctl.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <utility>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

class KernelLine final : public OutputLine {
 public:
  explicit KernelLine(UniqueFd fd) : fd_(std::move(fd)) {}
  bool set(bool is_on) override {
    gpio_v2_line_values values{.bits = is_on ? uint64_t{1} : uint64_t{0}, .mask = 1};
    return ::ioctl(fd_.get(), GPIO_V2_LINE_SET_VALUES_IOCTL, &values) == 0;
  }

 private:
  UniqueFd fd_;
};

Error unavailable(const std::string& what, const char* remedy) {
  return {ErrorKind::kUnavailable, "gpio: " + what + ": " + remedy};
}

}  // namespace

Result<std::unique_ptr<OutputLine>> open_output_line(const std::string& chip, const std::string& name) {
  const std::string path = chip.find('/') == std::string::npos ? "/dev/" + chip : chip;
  const UniqueFd device(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  gpiochip_info info{};
  if (!device || ::ioctl(device.get(), GPIO_GET_CHIPINFO_IOCTL, &info) != 0) {
    return unavailable(path + " is no GPIO chip that can be used (" + std::strerror(errno) + ")",
                       "check the chip in board.toml (gpiodetect lists them) and the permissions");
  }
  for (uint32_t offset = 0; offset < info.lines; ++offset) {
    gpio_v2_line_info line{};
    line.offset = offset;
    if (::ioctl(device.get(), GPIO_V2_GET_LINEINFO_IOCTL, &line) != 0 || name != line.name) continue;
    gpio_v2_line_request request{};
    request.offsets[0] = offset;
    request.num_lines = 1;
    std::strcpy(request.consumer, "ruffinid");
    request.config.flags = GPIO_V2_LINE_FLAG_OUTPUT;
    if (::ioctl(device.get(), GPIO_V2_GET_LINE_IOCTL, &request) != 0) {
      const char* reason = std::strerror(errno);
      return unavailable("line \"" + name + "\" of " + path + " cannot be had (" + reason + ")",
                         line.consumer[0] == '\0' ? "check the permissions" : "stop what uses it (gpioinfo names it)");
    }
    return std::unique_ptr<OutputLine>(std::make_unique<KernelLine>(UniqueFd(request.fd)));
  }
  return unavailable(path + " has no line \"" + name + "\"", "check the line in board.toml (gpioinfo lists the names)");
}

}  // namespace ruffini
