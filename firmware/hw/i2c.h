// A Linux I2C bus with combined write-read transfers. Calls wait for the bus: do not use them in the frame thread.
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
  // One attempt, at most 20 ms: writes `out` (may be empty), then reads `in` (may be empty) after a repeated start.
  // Returns 0 or an errno: ENXIO or EREMOTEIO if no device answers at the address, ETIMEDOUT if the bus hangs.
  [[nodiscard]] virtual int transfer(uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) = 0;
  // For messages, e.g. /dev/i2c-1.
  [[nodiscard]] virtual std::string name() const = 0;
};

// Errors: kUnavailable if it is missing, may not be opened, or does not support plain I2C.
[[nodiscard]] Result<std::unique_ptr<I2cBus>> open_i2c(const std::string& path);

// Attempts a transfer up to three times. Errors: kUnavailable, with bus, address, reason and remedy.
[[nodiscard]] Status exchange(I2cBus& bus, uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in);

// Reads the first `n_bytes` of an EEPROM with addresses of `address_bytes` (1 or 2) bytes. Errors as exchange().
[[nodiscard]] Result<std::vector<uint8_t>> read_eeprom(I2cBus& bus, uint8_t address, int address_bytes, size_t n_bytes);

}  // namespace ruffini
