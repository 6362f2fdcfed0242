#include "image/photometric_table.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int32_t kMinShift = 6;  // 9 bits between two lines of Q16
constexpr int32_t kMaxShift = 11;
constexpr int32_t kMaxLowQ12 = 8 * 4'096;  // no change is farther from zero

Error bad(const char* what) {
  return {ErrorKind::kBadInput, std::string("calibration file: ") + what + ": make it again"};
}

Status load_bend(const Calibration& calibration, PhotometricTable& table) {
  constexpr int n = PhotometricTable::kBendSize;
  if (calibration.tensor("photometric.bend") == nullptr) return Unit{};
  auto bend = calibration.tensor("photometric.bend", Tensor::Type::kI16, {n, n, n, 2});
  if (!bend) return bend.error();
  auto axis = calibration.tensor("photometric.bend_axis", Tensor::Type::kI32, {2, 3});
  if (!axis) return axis.error();
  const std::span<const int32_t> lines = axis.value()->as<int32_t>();
  std::copy_n(lines.begin(), 3, table.bend_low_q12.begin());
  std::copy_n(lines.begin() + 3, 3, table.bend_shift.begin());
  for (size_t c = 0; c < 3; ++c) {
    const bool has_low = table.bend_low_q12[c] >= -kMaxLowQ12 && table.bend_low_q12[c] <= kMaxLowQ12;
    if (!has_low || table.bend_shift[c] < kMinShift || table.bend_shift[c] > kMaxShift) {
      return bad("photometric.bend_axis has lines where no change of colour is");
    }
  }
  table.bend = bend.value()->as<int16_t>();
  return Unit{};
}

Status load_slopes(const Calibration& calibration, PhotometricTable& table) {
  constexpr int n = PhotometricTable::kSlopeSize;
  auto slope = calibration.tensor("photometric.slope", Tensor::Type::kI16, {n, n, 2});
  if (!slope) return slope.error();
  table.slope = slope.value()->as<int16_t>();
  const Tensor* unmix = calibration.tensor("photometric.unmix");
  if (unmix == nullptr || unmix->type != Tensor::Type::kI16 || unmix->shape.size() != 4 || unmix->shape[0] < 2 ||
      unmix->shape[1] < 2 || unmix->shape[2] != 2 || unmix->shape[3] != 3) {
    return bad("photometric.unmix is not [cells, cells, 2, 3]");
  }
  table.unmix = unmix->as<int16_t>();
  table.cells = {static_cast<int>(unmix->shape[1]), static_cast<int>(unmix->shape[0])};
  return load_bend(calibration, table);
}

Status load_depth(const Calibration& calibration, PhotometricTable& table) {
  auto depth = calibration.tensor("photometric.depth", Tensor::Type::kI16, {PhotometricTable::kDepthSize});
  if (!depth) return depth.error();
  if (calibration.tensor("photometric.slope") != nullptr || calibration.has_kind("camera")) {
    return bad("photometric.depth stands alone, without slopes and without a camera map");
  }
  table.depth = depth.value()->as<int16_t>();
  return Unit{};
}

}  // namespace

Result<PhotometricTable> PhotometricTable::load(const Calibration& calibration) {
  PhotometricTable table;
  const bool is_depth = calibration.tensor("photometric.depth") != nullptr;
  const Status tables = is_depth ? load_depth(calibration, table) : load_slopes(calibration, table);
  if (!tables) return tables.error();
  if (calibration.tensor("photometric.balance") != nullptr) {
    auto balance = calibration.tensor("photometric.balance", Tensor::Type::kI32, {1});
    if (!balance) return balance.error();
    const int32_t value = balance.value()->as<int32_t>()[0];
    if (value != 0 && value != 1) return bad("photometric.balance is neither 0 nor 1");
    table.is_balanced = value == 1;
  }
  return table;
}

}  // namespace ruffini
