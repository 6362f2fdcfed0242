#include "estimators/camera_motion.h"

#include <algorithm>
#include <cstdlib>

#include "base/fixed.h"
#include "estimators/common_part.h"
#include "solve/support_solver.h"

namespace ruffini {
namespace {

constexpr size_t kSides = 4;
constexpr int64_t kSigma = int64_t{1} << SupportSolver::kResidualFraction;
constexpr int64_t kMoved = 25 * kSigma;
constexpr int64_t kMovedPerN = 4 * kSigma;
constexpr int64_t kZoomed = 4 * kSigma;
constexpr int64_t kZoomedPerN = kSigma / 2;
constexpr int64_t kTorn = 40 * kSigma;
constexpr int64_t kTornPerN = 8 * kSigma;
constexpr int kCoveredSides = 3;
constexpr int64_t kUnPerN = 1'000'000;
constexpr int64_t kMaxUn = 1'000 * kUnPerN;  // clamp of each force component; larger forces make no difference

}  // namespace

CameraMotion::CameraMotion(GridSize nodes) {
  if (std::min(nodes.n_x, nodes.n_y) < kMinLattice) return;
  const auto add = [&](int column, int row) {
    const auto node = static_cast<uint32_t>(row * nodes.n_x + column);
    unknowns_.push_back(3 * node);
    unknowns_.push_back(3 * node + 1);
  };
  for (const int column : {kFromBorder, nodes.n_x - 1 - kFromBorder}) {
    for (const int row : {nodes.n_y / 4, nodes.n_y - 1 - nodes.n_y / 4}) add(column, row);
  }
  for (const int row : {kFromBorder, nodes.n_y - 1 - kFromBorder}) {
    for (const int column : {nodes.n_x / 4, nodes.n_x - 1 - nodes.n_x / 4}) add(column, row);
  }
}

bool CameraMotion::has_moved(std::span<const int32_t> residual, std::span<const uint8_t> mask,
                             const Wrench& wrench) const {
  if (unknowns_.empty()) return false;
  std::array<int64_t, kSides> x{};
  std::array<int64_t, kSides> y{};
  int64_t largest = 0;
  int n_covered = 0;
  for (size_t side = 0; side < kSides; ++side) {
    size_t n_touched = 0;
    for (size_t i = side * kPerSide; i < (side + 1) * kPerSide; ++i) {
      x[side] += residual[2 * i];
      y[side] += residual[2 * i + 1];
      n_touched += mask[unknowns_[2 * i] / 3] != 0 ? 1U : 0U;
    }
    x[side] = floor_div(x[side], int64_t{kPerSide});
    y[side] = floor_div(y[side], int64_t{kPerSide});
    largest = std::max({largest, std::abs(x[side]), std::abs(y[side])});
    n_covered += n_touched == kPerSide ? 1 : 0;
  }
  const auto size = [](int64_t force_un) { return std::min(std::abs(force_un), kMaxUn); };
  const int64_t force_un = size(wrench.force_x_un) + size(wrench.force_y_un) + size(wrench.force_z_un);
  const int64_t moved = kMoved + kMovedPerN * force_un / kUnPerN;
  const int64_t zoomed = kZoomed + kZoomedPerN * force_un / kUnPerN;
  if (n_covered >= kCoveredSides || largest > kTorn + kTornPerN * force_un / kUnPerN) return true;
  return common_part(x) > moved || common_part(y) > moved || common_part({-y[0], y[1], x[2], -x[3]}) > moved ||
         common_part({-x[0], x[1], -y[2], y[3]}) > zoomed;
}

}  // namespace ruffini
