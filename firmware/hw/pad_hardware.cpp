#include "hw/pad_hardware.h"

#include <chrono>
#include <thread>
#include <utility>

namespace ruffini {
namespace {

Result<std::unique_ptr<LedDriver>> open_driver(const LedDriverSettings& settings) {
  auto bus = open_i2c(settings.bus);
  if (!bus) return bus.error();
  return LedDriver::open(std::move(bus).value(), settings,
                         [](std::chrono::milliseconds time) { std::this_thread::sleep_for(time); });
}

}  // namespace

Result<PadHardware> PadHardware::open(const BoardSettings& board) {
  std::unique_ptr<I2cBus> bus;
  if (!board.eeprom.bus.empty()) {
    auto opened = open_i2c(board.eeprom.bus);
    if (!opened) return opened.error();
    bus = std::move(opened).value();
  }
  auto pad = open(board, std::move(bus));
  if (!pad) return pad;
  std::string& dark = pad.value().lamp_error_;
  if (!board.light.line.empty()) {
    auto lamps = open_output_line(board.light.chip, board.light.line);
    if (lamps && lamps.value()->set(true)) {
      pad.value().lamps_ = std::move(lamps).value();
    } else {
      dark = lamps ? std::string("their line cannot be set") : lamps.error().message;
    }
  }
  if (!board.led_driver.bus.empty()) {
    auto driver = open_driver(board.led_driver);
    if (driver) {
      pad.value().driver_ = std::move(driver).value();
    } else {
      dark += (dark.empty() ? "" : "; ") + driver.error().message;
    }
  }
  if (!dark.empty()) dark = "the lamps stay dark: " + dark;
  return pad;
}

std::string PadHardware::lamp_fault(std::optional<int32_t> milli_celsius) {
  if (!lamp_error_.empty() || driver_ == nullptr) return lamp_error_;
  return driver_->check(milli_celsius);
}

// Both leave the lamps dark; requesting a line sets it to off.
std::string PadHardware::lights_off(const BoardSettings& board) {
  std::string problem;
  if (!board.led_driver.bus.empty()) {
    LedDriverSettings none = board.led_driver;
    none.currents_ua.clear();
    none.ramp_ms = 0;
    if (const auto driver = open_driver(none); !driver) problem = driver.error().message;
  }
  if (!board.light.line.empty()) {
    const auto line = open_output_line(board.light.chip, board.light.line);
    if (!line) problem += (problem.empty() ? "" : "; ") + line.error().message;
  }
  return problem;
}

PadHardware::~PadHardware() {
  if (lamps_ != nullptr) static_cast<void>(lamps_->set(false));  // errors cannot be reported any more
}

Result<PadHardware> PadHardware::open(const BoardSettings& board, std::unique_ptr<I2cBus> bus) {
  PadHardware pad;
  pad.bus_ = std::move(bus);
  pad.eeprom_ = board.eeprom;
  const auto read = [&](int64_t address, IdentityKind kind) {
    return read_identity(*pad.bus_, static_cast<uint8_t>(address), board.eeprom.address_bytes, kind);
  };
  if (pad.bus_ == nullptr) return pad;
  if (board.eeprom.board_address != 0) {
    auto found = read(board.eeprom.board_address, IdentityKind::kBoard);
    if (!found) return found.error();
    if (!found.value().name.empty() && found.value().name != board.name) {
      return Error{ErrorKind::kRefused, "the board's EEPROM says that this is a \"" + found.value().name +
                                            "\", not \"" + board.name + "\": start ruffinid with --board " +
                                            found.value().name};
    }
    pad.board_serial_ = found.value().serial;
  }
  if (board.eeprom.gel_address != 0) {
    auto found = read(board.eeprom.gel_address, IdentityKind::kGel);
    if (!found) return found.error();
    pad.gel_serial_ = found.value().serial;
  }
  return pad;
}

std::string PadHardware::store_folder(const std::string& store) const {
  return gel_serial_.empty() ? store : store + "/gel-" + gel_serial_;
}

std::string PadHardware::gel_fault() {
  if (gel_serial_.empty()) return {};
  const auto found =
      read_identity(*bus_, static_cast<uint8_t>(eeprom_.gel_address), eeprom_.address_bytes, IdentityKind::kGel);
  if (found) {
    was_silent_ = false;
    if (found.value().serial == gel_serial_) return {};
    return "gel " + gel_serial_ + " was taken for " + found.value().serial +
           ": ruffinid starts again with its calibration";
  }
  if (!std::exchange(was_silent_, true)) return {};
  return "gel " + gel_serial_ + " is gone: " + found.error().message;
}

}  // namespace ruffini
