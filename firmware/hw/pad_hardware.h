// What is round the sensor beside its camera: its lamps, and EEPROMs that say which board and which gel these are.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "board/settings.h"
#include "hw/i2c.h"
#include "hw/identity.h"
#include "hw/led_driver.h"
#include "hw/output_line.h"

namespace ruffini {

class PadHardware {
 public:
  // Switches the lamps of [light] and [led_driver] on, until the end; reads the EEPROMs of [eeprom]. Errors: kUnavailable (bus, or nobody
  // answers), kBadInput (no identity), kRefused (the board's is that of another board.toml).
  [[nodiscard]] static Result<PadHardware> open(const BoardSettings& board);
  // With a bus that is open already.
  [[nodiscard]] static Result<PadHardware> open(const BoardSettings& board, std::unique_ptr<I2cBus> bus);

  // The board's serial number; empty where its EEPROM was not asked for.
  [[nodiscard]] const std::string& board_serial() const { return board_serial_; }
  // Why the lamps could not be switched on; empty where they are, or have a switch of their own. Frames are dark then,
  // and flagged so.
  [[nodiscard]] const std::string& dark() const { return dark_; }
  // Link thread, about once a second: dark(), or what their driver says of them (LedDriver::look); empty: all is well.
  [[nodiscard]] std::string lamp_fault(std::optional<int32_t> milli_celsius);
  // The lamps' line, for light.alternation; nullptr: there is none, or it could not be had.
  [[nodiscard]] OutputLine* lamps() { return lamps_.get(); }
  // After a daemon that was killed: everything of [light] and [led_driver] off. A sentence where that failed.
  [[nodiscard]] static std::string lights_off(const BoardSettings& board);
  // Where calibrations are kept: each gel has its own folder in `store`. Without a gel's EEPROM `store` itself.
  [[nodiscard]] std::string store_folder(const std::string& store) const;
  // Link thread, about once a second: a sentence where the gel is not the one of the start any more, or did not answer
  // twice in a row; empty while all is well. Takes at most 60 ms, where the bus hangs.
  [[nodiscard]] std::string lost();

  PadHardware(PadHardware&&) = default;
  PadHardware& operator=(PadHardware&&) = delete;
  ~PadHardware();

 private:
  PadHardware() = default;

  std::unique_ptr<OutputLine> lamps_;
  std::unique_ptr<LedDriver> driver_;
  std::string dark_;
  std::unique_ptr<I2cBus> bus_;
  EepromSettings eeprom_;
  std::string board_serial_;
  std::string gel_serial_;
  bool was_silent_ = false;
};

}  // namespace ruffini
