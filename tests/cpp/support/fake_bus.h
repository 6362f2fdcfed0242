// An I2C bus with EEPROMs in memory, and faults to order.
#pragma once

#include <cerrno>
#include <cstdint>
#include <deque>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "hw/i2c.h"

namespace ruffini {

class FakeBus final : public I2cBus {
 public:
  explicit FakeBus(int address_bytes) : address_bytes_(static_cast<size_t>(address_bytes)) {}

  int transfer(uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) override {
    ++n_transfers;
    if (!errors.empty()) {
      const int error = errors.front();
      errors.pop_front();
      if (error != 0) return error;
    }
    const auto found = memories.find(address);
    if (found == memories.end()) return ENXIO;
    if (out.size() != address_bytes_) return EINVAL;
    size_t place = 0;
    for (const uint8_t byte : out) place = place << 8 | byte;
    for (uint8_t& byte : in) byte = place < found->second.size() ? found->second[place++] : 0xFF;
    return 0;
  }
  [[nodiscard]] std::string name() const override { return "fake bus"; }

  std::map<uint8_t, std::vector<uint8_t>> memories;
  std::deque<int> errors;  // of the next transfers; 0: none
  int n_transfers = 0;

 private:
  size_t address_bytes_;
};

}  // namespace ruffini
