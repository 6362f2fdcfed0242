// Lamps on an I2C constant-current driver, NXP PCA9955B with 16 outputs (product data sheet, revision 2.2).
//
//   current of output i = IREF_i 225 mV / R      R: [led_driver] resistor_ohm, at its pin REXT; 225 uA a step at 1 kOhm
//
//   0x00 MODE1    0x00: awake, no address but its own     0x01 MODE2  bit 7 too hot, bit 6 an output is open or shorted
//   0x02 LEDOUT0  two bits an output: 0 off, 1 on without PWM      0x18 IREF0      0x46 EFLAG0  two bits an output:
//   0x80 in front of a register: the next byte is the next one's   0 well, 1 shorted, 2 open
//
// Its pin OE (low: lit) remains available for the line of [light], which light.alternation needs. Not for the frame
// thread.
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

  // Switches all outputs off, then ramps to the board's currents within ramp_ms, in 32 steps; returns after the ramp.
  // Errors: kUnavailable (no device answers, or registers do not keep their values), kBadInput (a current beyond 255
  // steps).
  [[nodiscard]] static Result<std::unique_ptr<LedDriver>> open(std::unique_ptr<I2cBus> bus,
                                                               const LedDriverSettings& settings, const Sleep& sleep);
  // Checks that a device answers at the address; switches nothing. Errors: kUnavailable.
  [[nodiscard]] static Status find(I2cBus& bus, int64_t address);
  // Switches the lamps off; errors cannot be reported any more.
  ~LedDriver();
  LedDriver(const LedDriver&) = delete;
  LedDriver& operator=(const LedDriver&) = delete;

  // Call about once a second. Returns the problem in one sentence; empty: the lamps are as configured. If the chip or
  // [temperature] (no value: unknown) is too hot, the lamps go out until ruffinid is restarted. Currents lost in a
  // supply dip are reported, not written again: the lamps' heat, and so the rest image, would differ.
  [[nodiscard]] std::string check(std::optional<int32_t> milli_celsius);
  // All outputs off.
  [[nodiscard]] Status off();

  // Current step of each output for the board's currents.
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
  std::array<uint8_t, kOutputs / 4> lit_{};  // LEDOUT values of the outputs in use
  std::string out_;                          // why the lamps were switched off; empty: they are lit
};

}  // namespace ruffini
