// An I2C bus of Linux: write, then read, in one go. Calls wait for the bus: never in the frame thread.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"

namespace ruffini {

class I2cBus {
 public:
  virtual ~I2cBus() = default;
  // One try, at most 20 ms: writes `out` (may be empty), then with a repeated start reads `in` (may be empty).
  // 0, or an errno: ENXIO or EREMOTEIO where nobody answers at the address, ETIMEDOUT where the bus hangs.
  [[nodiscard]] virtual int transfer(uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) = 0;
  // For messages, e.g. /dev/i2c-1.
  [[nodiscard]] virtual std::string name() const = 0;
};

// Errors: kUnavailable, where it is missing, may not be opened, or cannot do plain I2C.
[[nodiscard]] Result<std::unique_ptr<I2cBus>> open_i2c(const std::string& path);

// A transfer that is tried three times. Errors: kUnavailable, with bus, address, reason and remedy.
[[nodiscard]] Status exchange(I2cBus& bus, uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in);

// The first `n_bytes` of an EEPROM whose places have `address_bytes` (1 or 2) bytes. Errors as exchange().
[[nodiscard]] Result<std::vector<uint8_t>> read_eeprom(I2cBus& bus, uint8_t address, int address_bytes, size_t n_bytes);

}  // namespace ruffini
