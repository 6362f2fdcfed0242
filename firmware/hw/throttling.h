// What the computer says of its power and heat: a file with one hexadecimal number, as a Raspberry Pi has it.
//
//   bit 0 power is short now, 1 its clock is held down, 2 it is throttled, 3 it is near its temperature limit;
//   bits 16 to 19: the same has been so since it was started
//
// /sys/devices/platform/soc/soc:firmware/get_throttled. Never in the frame thread: a read may ask another processor.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace ruffini {

class Throttling {
 public:
  // An empty path: not asked.
  explicit Throttling(std::string path) : path_(std::move(path)) {}

  // Nothing where the file cannot be read, or holds no such number.
  [[nodiscard]] std::optional<uint32_t> bits() const;

 private:
  std::string path_;
};

}  // namespace ruffini
