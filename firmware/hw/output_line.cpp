#include "hw/output_line.h"

#include <gpiod.h>

#include <cerrno>
#include <cstring>
#include <utility>

namespace ruffini {
namespace {

template <typename T>
using Owned = std::unique_ptr<T, void (*)(T*)>;

class GpiodLine final : public OutputLine {
 public:
  GpiodLine(Owned<gpiod_line_request> request, unsigned offset) : request_(std::move(request)), offset_(offset) {}
  // One system call and no allocation (libgpiod 2.2 and 2.3): the strobe and the reflex are set in the frame path.
  bool set(bool is_on) override {
    const auto value = is_on ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
    return gpiod_line_request_set_value(request_.get(), offset_, value) == 0;
  }

 private:
  Owned<gpiod_line_request> request_;
  unsigned offset_;
};

// Null, and why in `reason`, if it is not granted. An output of new settings is off.
Owned<gpiod_line_request> request_output(gpiod_chip* chip, unsigned offset, int& reason) {
  const Owned<gpiod_line_settings> settings(gpiod_line_settings_new(), gpiod_line_settings_free);
  const Owned<gpiod_line_config> lines(gpiod_line_config_new(), gpiod_line_config_free);
  const Owned<gpiod_request_config> request(gpiod_request_config_new(), gpiod_request_config_free);
  gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
  gpiod_line_config_add_line_settings(lines.get(), &offset, 1, settings.get());
  gpiod_request_config_set_consumer(request.get(), "ruffinid");
  Owned<gpiod_line_request> granted(gpiod_chip_request_lines(chip, request.get(), lines.get()),
                                    gpiod_line_request_release);
  reason = errno;  // what is freed here may set another one
  return granted;
}

Error unavailable(const std::string& what, const char* remedy) {
  return {ErrorKind::kUnavailable, "gpio: " + what + ": " + remedy};
}

}  // namespace

Result<std::unique_ptr<OutputLine>> open_output_line(const std::string& chip, const std::string& name) {
  const std::string path = chip.find('/') == std::string::npos ? "/dev/" + chip : chip;
  const Owned<gpiod_chip> device(gpiod_chip_open(path.c_str()), gpiod_chip_close);
  if (!device) {
    return unavailable(path + " is no GPIO chip that can be used (" + std::strerror(errno) + ")",
                       "check the chip in board.toml (gpiodetect lists them) and the permissions");
  }
  const int offset = gpiod_chip_get_line_offset_from_name(device.get(), name.c_str());
  if (offset < 0) {
    return unavailable(path + " has no line \"" + name + "\"",
                       "check the line in board.toml (gpioinfo lists the names)");
  }
  int reason = 0;
  auto request = request_output(device.get(), static_cast<unsigned>(offset), reason);
  if (!request) {
    return unavailable("line \"" + name + "\" of " + path + " cannot be had (" + std::strerror(reason) + ")",
                       reason == EBUSY ? "stop what uses it (gpioinfo names it)" : "check the permissions");
  }
  return std::unique_ptr<OutputLine>(std::make_unique<GpiodLine>(std::move(request), static_cast<unsigned>(offset)));
}

}  // namespace ruffini
