// Sections of board.toml about the hardware around the sensor.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace ruffini {

// Manual exposure; all 0: the camera's automatics are used.
struct ExposureSettings {
  int64_t time_us = 0;
  int64_t gain_1e3 = 0;
  int64_t red_1e3 = 0;  // channel gains relative to green
  int64_t blue_1e3 = 0;
  int64_t white_kelvin = 0;  // colour of the light, instead of the two gains, for USB cameras; 0: the gains are used

  [[nodiscard]] bool is_manual() const { return time_us != 0; }
};

// USB identity by which a host recognizes this sensor. The firmware does not use it.
struct UsbSettings {
  int64_t vendor = 0;  // 0: only the names are used
  int64_t product = 0;
  std::vector<std::string> names{};  // substrings of the name that the kernel gives its camera
};

// A Linux thermometer (hw/thermometer.h); both empty: none.
struct TemperatureSettings {
  std::string place;  // name in STATUS
  std::string path;
};

// Lamps of the pad, on while ruffinid runs. An empty line: they are not switched by ruffinid.
struct LightSettings {
  std::string chip;
  std::string line;
  // Every second frame is taken with the lamps off and subtracted from the next one, which removes ambient light.
  // camera.rate_mhz counts pairs: the camera runs at twice that rate.
  bool alternates = false;
};

// I2C LED driver for the lamps (hw/led_driver.h); an empty bus: none.
struct LedDriverSettings {
  std::string bus;
  int64_t address = 0;
  int64_t resistor_ohm = 0;               // determines the current per step
  std::vector<int64_t> currents_ua{};     // of the outputs, starting from the first; the others are off
  int64_t ramp_ms = 0;                    // duration of the ramp from dark to these currents
  int64_t max_milli_celsius = INT32_MAX;  // of [temperature]: the lamps are switched off above it
};

// Two cameras that provide half of the picture each, side by side (capture/paired_camera.h); 0: one camera.
struct StereoSettings {
  int64_t tolerance_us = 0;  // between the exposure midpoints of a pair
};

// I2C memories that identify board and gel (hw/identity.h); an empty bus: none; address 0: not present.
struct EepromSettings {
  std::string bus;
  int64_t board_address = 0;
  int64_t gel_address = 0;
  int address_bytes = 1;  // 1 up to 256 bytes of memory, 2 above
};

// Scheduling of one thread. A value of 0 leaves the inherited setting.
struct ThreadSettings {
  int priority = 0;   // of SCHED_FIFO
  uint64_t cpus = 0;  // bit mask of permitted CPUs
};

struct ThreadsSettings {
  ThreadSettings capture;
  ThreadSettings frame;
  ThreadSettings link;
  ThreadSettings inference;  // has no priority: it runs only when the CPU is idle
};

// Settings by role: "capture", "frame", "link"; any other: inference.
inline const ThreadSettings& thread_of(const ThreadsSettings& threads, std::string_view role) {
  return role == "capture" ? threads.capture
         : role == "frame" ? threads.frame
         : role == "link"  ? threads.link
                           : threads.inference;
}

}  // namespace ruffini
