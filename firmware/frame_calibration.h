// A calibration file in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// A parsed calibration together with the bytes that it refers to.
class CalibrationFile {
 public:
  [[nodiscard]] static Result<std::shared_ptr<const CalibrationFile>> load(std::vector<uint8_t> bytes);
  [[nodiscard]] const Calibration& get() const { return calibration_; }
  [[nodiscard]] std::span<const uint8_t> bytes() const { return bytes_; }

 private:
  std::vector<uint8_t> bytes_;
  Calibration calibration_;
};

}  // namespace ruffini
