#include "solve/spread_check.h"

#include <algorithm>
#include <array>
#include <cstdlib>

namespace ruffini {
namespace {

Error bad(const char* what) {
  return {ErrorKind::kBadInput, std::string("calibration file: ") + what + ": make the operator again"};
}

}  // namespace

Result<SpreadCheck> SpreadCheck::load(const Calibration& calibration, GridSize nodes,
                                      std::span<const NodePlace> places) {
  const int n = 3 * nodes.count();
  if (nodes.count() > kMaxNodes) return bad("support.spread is for at most 4096 nodes");
  auto spread = calibration.tensor("support.spread", Tensor::Type::kI32, {n});
  if (!spread) return spread.error();
  auto limit = calibration.tensor("support.spread_limit", Tensor::Type::kI32, {1});
  if (!limit) return limit.error();
  SpreadCheck out;
  out.place_.assign(places.begin(), places.end());
  out.spread_ = spread.value()->as<int32_t>();
  out.limit_ = limit.value()->as<int32_t>()[0];
  const auto is_beyond = [](int32_t v) { return v < -kMaxSpread || v > kMaxSpread; };
  if (std::any_of(out.spread_.begin(), out.spread_.end(), is_beyond)) return bad("support.spread is beyond 2^23");
  if (out.limit_ < 1) return bad("support.spread_limit is not positive");
  return out;
}

bool SpreadCheck::is_explained(std::span<const int16_t> u, std::span<const NodeForce> force,
                               std::span<const NodeForce> beyond, bool is_pressed) const {
  int64_t seen = 0;       // in um times 1/8 um
  int64_t all = 0;        // same unit, of absolute values
  int64_t explained = 0;  // same unit
  bool has_force = false;
  for (size_t i = 0; i < place_.size(); ++i) {
    const int64_t x = int64_t{place_[i].x_um} * u[3 * i];
    const int64_t y = int64_t{place_[i].y_um} * u[3 * i + 1];
    seen += x + y;
    all += std::abs(x) + std::abs(y);
    const NodeForce more = beyond.empty() ? NodeForce{} : beyond[i];
    const std::array<int64_t, 3> steps = {int64_t{force[i].x} - more.x, int64_t{force[i].y} - more.y,
                                          int64_t{force[i].z} - more.z};
    if ((steps[0] | steps[1] | steps[2]) == 0) continue;  // most nodes: only those in contact have forces
    has_force = true;
    for (size_t axis = 0; axis < steps.size(); ++axis) {
      explained += spread_[3 * i + axis] * std::clamp<int64_t>(steps[axis], -kMaxForce, kMaxForce);
    }
  }
  if (has_force && is_pressed) return std::abs(seen - explained) <= kPressedHalves * limit_ / 2 + (kShareQ8 * all >> 8);
  return std::abs(seen) <= std::min(limit_ + (kShareQ8 * odd_part(u) >> 8), std::max(limit_, all) / 2);
}

int64_t SpreadCheck::odd_part(std::span<const int16_t> u) const {
  int64_t sum = 0;
  for (size_t i = 0, j = place_.size(); i < --j; ++i) {
    const int64_t x = int64_t{place_[i].x_um} * (u[3 * i] - u[3 * j]);
    const int64_t y = int64_t{place_[i].y_um} * (u[3 * i + 1] - u[3 * j + 1]);
    sum += std::abs(x + y);
  }
  return sum;
}

bool is_rim_pressed(GridSize nodes, std::span<const NodeForce> force, int64_t threshold_lsb) {
  int n_pressed = 0;
  int n_rim = 0;
  for (int y = 0; y < nodes.n_y; ++y) {
    const bool is_whole_row = y == 0 || y + 1 == nodes.n_y;
    for (int x = 0; x < nodes.n_x; x += is_whole_row ? 1 : std::max(nodes.n_x - 1, 1)) {
      ++n_rim;
      n_pressed += force[static_cast<size_t>(y * nodes.n_x + x)].z < -threshold_lsb / 4 ? 1 : 0;
    }
  }
  return 8 * n_pressed > n_rim;
}

}  // namespace ruffini
