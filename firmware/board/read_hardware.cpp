#include "board/read_hardware.h"

namespace ruffini {
namespace {

constexpr size_t kMaxLineLength = 31;  // of a GPIO line, as the kernel has it
constexpr size_t kMaxPathLength = 128;
constexpr size_t kLedOutputs = 16;
constexpr size_t kMaxUsbNames = 8;
constexpr int kMaxPriority = 49;  // the kernel's interrupt threads have 50
constexpr int kMaxCpu = 63;       // ThreadSettings::cpus

void read_exposure(BoardReader& in, BoardSettings& board) {
  if (!in.has_section("exposure")) return;
  in.section("exposure");
  board.exposure.time_us = in.integer("time_us", 10, 1'000'000);
  board.exposure.gain_1e3 = in.integer("gain_1e3", 1'000, 64'000);
  const bool has_gains = in.has("red_1e3") || in.has("blue_1e3");
  if (has_gains == in.has("white_kelvin")) in.fail("[exposure] needs red_1e3 and blue_1e3, or white_kelvin instead");
  if (has_gains) {
    board.exposure.red_1e3 = in.integer("red_1e3", 100, 32'000);
    board.exposure.blue_1e3 = in.integer("blue_1e3", 100, 32'000);
  } else {
    board.exposure.white_kelvin = in.integer("white_kelvin", 1'000, 20'000);
  }
}

void read_usb(BoardReader& in, UsbSettings& usb) {
  if (!in.has_section("usb")) return;
  in.section("usb");
  const bool has_identity = in.has("vendor") || in.has("product");
  if (has_identity) {
    usb.vendor = in.integer("vendor", 1, 0xffff);
    usb.product = in.integer("product", 1, 0xffff);
  }
  if (in.has("names")) usb.names = in.texts("names", kMaxUsbNames);
  if (!has_identity && usb.names.empty()) in.fail("[usb] has nothing to recognise: give vendor and product, or names");
}

void read_light(BoardReader& in, LightSettings& light) {
  if (!in.has_section("light")) return;
  in.section("light");
  light.chip = in.text("chip", kMaxPathLength);
  light.line = in.text("line", kMaxLineLength);
  in.set_default("alternation", "none");
  light.alternates = in.choice("alternation", {"none", "lit_dark"}) == 1;
}

// Upper limit of a current: 255 steps (hw/led_driver.h) with the smallest resistor, which gives 57 mA.
void read_led_driver(BoardReader& in, LedDriverSettings& driver) {
  if (!in.has_section("led_driver")) return;
  in.section("led_driver");
  driver.bus = in.text("bus", kMaxPathLength);
  if (driver.bus.rfind('/', 0) != 0) in.fail("led_driver.bus must begin with /");
  driver.address = in.integer("address", 8, 0x77);
  driver.resistor_ohm = in.integer("resistor_ohm", 500, 10'000);
  driver.currents_ua = in.integers("currents_ua", 0, 57'375);
  if (driver.currents_ua.size() > kLedOutputs) in.fail("led_driver.currents_ua lists more than 16 outputs");
  driver.ramp_ms = in.integer("ramp_ms", 0, 10'000);
  if (in.has("max_milli_celsius")) driver.max_milli_celsius = in.integer("max_milli_celsius", 0, 150'000);
}

void read_stereo(BoardReader& in, StereoSettings& stereo) {
  if (!in.has_section("stereo")) return;
  in.section("stereo");
  stereo.tolerance_us = in.integer("tolerance_us", 1, 100'000);
}

// Checks across these sections.
void check_hardware(BoardReader& in, const BoardSettings& board) {
  const int64_t n_exposures = board.light.alternates ? 2 : 1;  // per frame
  if (n_exposures * board.exposure.time_us * board.camera.rate_mhz > 1'000'000'000) {
    in.fail(n_exposures == 1
                ? "exposure.time_us is longer than a frame at camera.rate_mhz"
                : "exposure.time_us is longer than half a frame at camera.rate_mhz, which light.alternation "
                  "takes two exposures in");
  }
  if (board.stereo.tolerance_us * 2 * board.camera.rate_mhz > 1'000'000'000) {
    in.fail("stereo.tolerance_us is longer than half a frame at camera.rate_mhz");
  }
  if (board.stereo.tolerance_us != 0 && board.camera.width_px % 2 != 0) {
    in.fail("[stereo] needs an even camera.width_px: each camera makes half of it");
  }
  if (board.stereo.tolerance_us != 0 && board.light.alternates) {
    in.fail("[stereo] and light.alternation lit_dark cannot be had together");
  }
  if (board.light.alternates && !board.exposure.is_manual()) {
    in.fail("light.alternation lit_dark needs [exposure]: the camera's automatics would follow the lamps");
  }
  if (board.led_driver.max_milli_celsius != INT32_MAX && board.temperature.path.empty()) {
    in.fail("led_driver.max_milli_celsius needs [temperature]");
  }
}

// Addresses below 8 and above 0x77 are reserved by I2C.
void read_eeprom(BoardReader& in, EepromSettings& eeprom) {
  if (!in.has_section("eeprom")) return;
  in.section("eeprom");
  eeprom.bus = in.text("bus", kMaxPathLength);
  if (eeprom.bus.rfind('/', 0) != 0) in.fail("eeprom.bus must begin with /");
  if (in.has("board_address")) eeprom.board_address = in.integer("board_address", 8, 0x77);
  if (in.has("gel_address")) eeprom.gel_address = in.integer("gel_address", 8, 0x77);
  eeprom.address_bytes = static_cast<int>(in.integer("address_bytes", 1, 2));
  if (eeprom.board_address == eeprom.gel_address) {
    in.fail("[eeprom] needs board_address or gel_address, and not the same for both");
  }
}

void read_reflex(BoardReader& in, ReflexSettings& reflex) {
  if (!in.has_section("reflex")) return;
  in.section("reflex");
  reflex.chip = in.text("chip", kMaxPathLength);
  reflex.line = in.text("line", kMaxLineLength);
  reflex.force_un = in.integer("force_un", 0, 2'000'000'000);
  constexpr ReflexSlip kSlips[] = {ReflexSlip::kNone, ReflexSlip::kIncipient, ReflexSlip::kSlides};
  reflex.slip = kSlips[in.choice("slip", {"none", "incipient", "slides"})];
  constexpr WhenInvalid kWhen[] = {WhenInvalid::kHold, WhenInvalid::kOn, WhenInvalid::kOff};
  reflex.when_invalid = kWhen[in.choice("when_invalid", {"hold", "on", "off"})];
  if (reflex.force_un == 0 && reflex.slip == ReflexSlip::kNone) {
    in.fail("[reflex] has no limit: give force_un above 0, or slip");
  }
}

void read_temperature(BoardReader& in, TemperatureSettings& temperature) {
  if (!in.has_section("temperature")) return;
  in.section("temperature");
  temperature.place = in.text("place", kMaxListedLength);
  temperature.path = in.text("path", kMaxPathLength);
  if (temperature.path.rfind('/', 0) != 0) in.fail("temperature.path must begin with /");
}

void read_thread(BoardReader& in, const std::string& role, bool has_priority, ThreadSettings& thread) {
  const std::string priority = role + "_priority";
  const std::string cpus = role + "_cpus";
  if (has_priority && in.has(priority.c_str())) {
    thread.priority = static_cast<int>(in.integer(priority.c_str(), 1, kMaxPriority));
  }
  if (!in.has(cpus.c_str())) return;
  for (const int64_t cpu : in.integers(cpus.c_str(), 0, kMaxCpu)) thread.cpus |= uint64_t{1} << cpu;
}

// The thread of a learned network runs only when the CPU is idle and has no priority.
void read_threads(BoardReader& in, ThreadsSettings& threads) {
  if (!in.has_section("threads")) return;
  in.section("threads");
  read_thread(in, "capture", true, threads.capture);
  read_thread(in, "frame", true, threads.frame);
  read_thread(in, "link", true, threads.link);
  read_thread(in, "inference", false, threads.inference);
}

}  // namespace

void read_hardware(BoardReader& in, BoardSettings& board) {
  read_exposure(in, board);
  read_usb(in, board.usb);
  read_light(in, board.light);
  read_led_driver(in, board.led_driver);
  read_stereo(in, board.stereo);
  read_eeprom(in, board.eeprom);
  read_temperature(in, board.temperature);
  read_reflex(in, board.reflex);
  read_threads(in, board.threads);
  if (in.error().empty()) check_hardware(in, board);
}

}  // namespace ruffini
