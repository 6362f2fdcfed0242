// A calibration file in memory for as long as somebody reads its tables.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <utility>

#include "frame_path.h"
#include "support/calibration_bytes.h"

namespace ruffini::test {

inline std::shared_ptr<const CalibrationFile> held(CalibrationBytes& file) {
  auto loaded = CalibrationFile::load(file.bytes());
  EXPECT_TRUE(loaded.has_value()) << (loaded ? "" : loaded.error().message);
  return std::move(loaded).value();
}

}  // namespace ruffini::test
