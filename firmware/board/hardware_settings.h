// The part of board.toml about what is round the sensor.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace ruffini {

// What the camera is told instead of its automatics; all 0: it is left to them.
struct ExposureSettings {
  int64_t time_us = 0;
  int64_t gain_1e3 = 0;
  int64_t red_1e3 = 0;  // gains of the channels over green
  int64_t blue_1e3 = 0;
  int64_t white_kelvin = 0;  // colour of the light, instead of the two, for a camera on USB; 0: it is the two

  [[nodiscard]] bool is_manual() const { return time_us != 0; }
};

// By which a host that has this sensor on USB recognises it; the firmware does not use it.
struct UsbSettings {
  int64_t vendor = 0;  // 0: the names alone count
  int64_t product = 0;
  std::vector<std::string> names{};  // parts of the name that the kernel gives its camera
};

// A thermometer of Linux (hw/thermometer.h); both empty: none.
struct TemperatureSettings {
  std::string place;  // what STATUS calls it
  std::string path;
};

// The pad's lamps, switched on while ruffinid runs; an empty line: they have a switch of their own.
struct LightSettings {
  std::string chip;
  std::string line;
  // Every second frame of the camera is taken with the lamps off, and taken from the one after it: what the lamps did
  // not make is gone. camera.rate_mhz counts pairs: the camera runs at twice that.
  bool alternates = false;
};

// A driver of LEDs on I2C that the lamps hang on (hw/led_driver.h); an empty bus: none.
struct LedDriverSettings {
  std::string bus;
  int64_t address = 0;
  int64_t resistor_ohm = 0;               // sets the current of one step
  std::vector<int64_t> currents_ua{};     // of the outputs from the first on; the others are off
  int64_t ramp_ms = 0;                    // from dark to those
  int64_t max_milli_celsius = INT32_MAX;  // of [temperature]: the lamps go out above
};

// Two cameras, each of half the picture, side by side (capture/paired_camera.h); 0: one camera.
struct StereoSettings {
  int64_t tolerance_us = 0;  // between the middles of exposure of a pair
};

// Memories on I2C that say which board and which gel these are (hw/identity.h); an empty bus: none; address 0: not that.
struct EepromSettings {
  std::string bus;
  int64_t board_address = 0;
  int64_t gel_address = 0;
  int address_bytes = 1;  // 1 up to 256 bytes of memory, 2 above
};

// Of one thread. What is 0 stays as ruffinid was started.
struct ThreadSettings {
  int priority = 0;   // of SCHED_FIFO
  uint64_t cpus = 0;  // a bit for each that it may run on
};

struct ThreadsSettings {
  ThreadSettings capture;
  ThreadSettings frame;
  ThreadSettings link;
  ThreadSettings inference;  // no priority: it runs when nothing else does
};

// By its role: "capture", "frame", "link", else "inference".
inline const ThreadSettings& thread_of(const ThreadsSettings& threads, std::string_view role) {
  return role == "capture" ? threads.capture
         : role == "frame" ? threads.frame
         : role == "link"  ? threads.link
                           : threads.inference;
}

}  // namespace ruffini
