// Hardware of the pad besides its camera: lamps, and the EEPROMs that identify board and gel.
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
  // Switches the lamps of [light] and [led_driver] on, until the destructor, and reads the EEPROMs of [eeprom]. Errors:
  // kUnavailable (bus, or no device answers), kBadInput (no identity), kRefused (identity of another board).
  [[nodiscard]] static Result<PadHardware> open(const BoardSettings& board);
  // With a bus that is already open.
  [[nodiscard]] static Result<PadHardware> open(const BoardSettings& board, std::unique_ptr<I2cBus> bus);

  // Serial number of the board; empty if its EEPROM is not configured.
  [[nodiscard]] const std::string& board_serial() const { return board_serial_; }
  // Why the lamps could not be switched on; empty if they are on or not switched by ruffinid. Frames are dark then and
  // flagged.
  [[nodiscard]] const std::string& lamp_error() const { return lamp_error_; }
  // Link thread, about once a second: lamp_error(), or the fault of the LED driver (LedDriver::check); empty: no fault.
  [[nodiscard]] std::string lamp_fault(std::optional<int32_t> milli_celsius);
  // The lamps' line, for light.alternation; nullptr if there is none or it was unavailable.
  [[nodiscard]] OutputLine* lamps() { return lamps_.get(); }
  // Switches [light] and [led_driver] off after a daemon was killed. Returns a sentence if that failed.
  [[nodiscard]] static std::string lights_off(const BoardSettings& board);
  // Folder of the calibrations: each gel has its own in `store`. Without a gel EEPROM it is `store` itself.
  [[nodiscard]] std::string store_folder(const std::string& store) const;
  // Link thread, about once a second: returns a sentence if the gel was exchanged since the start, or did not answer
  // twice in a row; otherwise empty. Takes at most 60 ms if the bus hangs.
  [[nodiscard]] std::string gel_fault();

  PadHardware(PadHardware&&) = default;
  PadHardware& operator=(PadHardware&&) = delete;
  ~PadHardware();

 private:
  PadHardware() = default;

  std::unique_ptr<OutputLine> lamps_;
  std::unique_ptr<LedDriver> driver_;
  std::string lamp_error_;
  std::unique_ptr<I2cBus> bus_;
  EepromSettings eeprom_;
  std::string board_serial_;
  std::string gel_serial_;
  bool was_silent_ = false;
};

}  // namespace ruffini
