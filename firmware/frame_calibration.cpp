#include "frame_calibration.h"

#include <utility>

namespace ruffini {

static_assert(__STDCPP_DEFAULT_NEW_ALIGNMENT__ >= 8, "tables are read where the file lies");

Result<std::shared_ptr<const CalibrationFile>> CalibrationFile::load(std::vector<uint8_t> bytes) {
  auto file = std::make_shared<CalibrationFile>();
  file->bytes_ = std::move(bytes);
  auto parsed = Calibration::parse(file->bytes_);
  if (!parsed) return parsed.error();
  file->calibration_ = std::move(parsed).value();
  return std::shared_ptr<const CalibrationFile>(std::move(file));
}

}  // namespace ruffini
