// Power and thermal state of the computer: a file with one hexadecimal number, as on a Raspberry Pi.
//
//   bit 0 under-voltage, 1 clock capped, 2 throttled, 3 near the temperature limit;
//   bits 16 to 19: the same has occurred since boot
//
// /sys/devices/platform/soc/soc:firmware/get_throttled. Not for the frame thread: a read may query another processor.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace ruffini {

class Throttling {
 public:
  // An empty path: not available.
  explicit Throttling(std::string path) : path_(std::move(path)) {}

  // Returns no value if the file cannot be read or holds no such number.
  [[nodiscard]] std::optional<uint32_t> bits() const;

 private:
  std::string path_;
};

}  // namespace ruffini
