#include "frame_calibration.h"

#include <cstring>
#include <utility>

namespace ruffini {

Result<std::shared_ptr<const CalibrationFile>> CalibrationFile::load(std::span<const uint8_t> bytes) {
  auto file = std::make_shared<CalibrationFile>();
  file->storage_.resize((bytes.size() + 7) / 8);
  file->n_bytes_ = bytes.size();
  if (!bytes.empty()) std::memcpy(file->storage_.data(), bytes.data(), bytes.size());
  auto parsed = Calibration::parse(file->bytes());
  if (!parsed) return parsed.error();
  file->calibration_ = std::move(parsed).value();
  return std::shared_ptr<const CalibrationFile>(std::move(file));
}

std::span<const uint8_t> CalibrationFile::bytes() const {
  return {reinterpret_cast<const uint8_t*>(storage_.data()), n_bytes_};
}

}  // namespace ruffini
