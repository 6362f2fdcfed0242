// Lamps on a constant-current driver on I2C: NXP PCA9955B, 16 outputs (product data sheet, revision 2.2).
//
//   current of output i = IREF_i 225 mV / R      R: [led_driver] resistor_ohm, at its pin REXT; 225 uA a step at 1 kOhm
//
//   0x00 MODE1    0x00: awake, no address but its own     0x01 MODE2  bit 7 too hot, bit 6 an output is open or shorted
//   0x02 LEDOUT0  two bits an output: 0 off, 1 on without PWM      0x18 IREF0      0x46 EFLAG0  two bits an output:
//   0x80 in front of a register: the next byte is the next one's   0 well, 1 shorted, 2 open
//
// Its pin OE (low: lit) is free for the line of [light], which light.alternation needs. Not of the frame thread.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "board/hardware_settings.h"
#include "hw/i2c.h"

namespace ruffini {

class LedDriver {
 public:
  static constexpr size_t kOutputs = 16;
  using Sleep = std::function<void(std::chrono::milliseconds)>;

  // Everything off, then from dark to the currents of the board within ramp_ms, in 32 steps. Takes that long.
  // Errors: kUnavailable (nobody answers, or what is written does not stay), kBadInput (a current beyond 255 steps).
  [[nodiscard]] static Result<std::unique_ptr<LedDriver>> open(std::unique_ptr<I2cBus> bus,
                                                               const LedDriverSettings& settings, const Sleep& sleep);
  // Whether something answers at the address, without switching anything. Errors: kUnavailable.
  [[nodiscard]] static Status find(I2cBus& bus, int64_t address);
  // Off; nobody is left to hear where that fails.
  ~LedDriver();
  LedDriver(const LedDriver&) = delete;
  LedDriver& operator=(const LedDriver&) = delete;

  // About once a second: what is wrong, in a sentence; empty: the lamps are as asked. Too hot, by the chip or by
  // [temperature] (nothing: not known): the lamps go out, and stay out until ruffinid is started again. Currents that
  // a dip of the supply took are told, not written again: the lamps' heat and the rest picture are not the same after it.
  [[nodiscard]] std::string look(std::optional<int32_t> milli_celsius);
  // All outputs off.
  [[nodiscard]] Status off();

  // Of each output, for the currents of the board.
  [[nodiscard]] const std::array<uint8_t, kOutputs>& steps() const { return steps_; }

 private:
  LedDriver(std::unique_ptr<I2cBus> bus, const LedDriverSettings& settings);
  [[nodiscard]] Status write(uint8_t first, std::span<const uint8_t> values);
  [[nodiscard]] Status read(uint8_t first, std::span<uint8_t> values);
  [[nodiscard]] Status light(const Sleep& sleep);
  [[nodiscard]] Result<bool> is_as_set();
  [[nodiscard]] std::string faults_of_outputs();

  std::unique_ptr<I2cBus> bus_;
  uint8_t address_;
  LedDriverSettings settings_;
  std::array<uint8_t, kOutputs> steps_{};
  std::array<uint8_t, kOutputs / 4> lit_{};  // LEDOUT of the outputs that have a current
  std::string out_;                          // why the lamps were put out; empty: they are lit
};

}  // namespace ruffini
