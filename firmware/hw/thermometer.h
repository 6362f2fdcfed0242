// A Linux thermometer: a file with one integer in thousandths of a degree Celsius.
//
// Examples are /sys/class/thermal/thermal_zone*/temp and /sys/class/hwmon/hwmon*/temp*_input. A read may wait for a
// bus: not for the frame thread.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "hw/board_io.h"

namespace ruffini {

class Thermometer final : public BoardIo {
 public:
  // An empty path: no thermometer.
  explicit Thermometer(std::string path) : path_(std::move(path)) {}

  // Returns no value if the file cannot be read or holds no integer from -100 to 300 degrees.
  [[nodiscard]] std::optional<int32_t> milli_celsius() const override;

 private:
  std::string path_;
};

}  // namespace ruffini
