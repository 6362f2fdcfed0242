// The second pass of the solve: linear forces of the nodes -> forces that explain their displacement.
//
//   refine     what finite strain adds, then least squares where touched (solve/support_solver.h)
//   remember   what the pad lost to relaxation (solve/relaxation.h)
//   leave      what the refined forces do not explain of the displacement; only where somebody asks
//
// Everything but the least squares is optional. Frame thread; no allocation after load.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "core/results.h"
#include "estimators/camera_motion.h"
#include "estimators/wrench.h"
#include "solve/contact_mask.h"
#include "solve/finite_strain.h"
#include "solve/relaxation.h"
#include "solve/spread_check.h"
#include "solve/support_solver.h"
#include "store/calibration.h"

namespace ruffini {

class SecondPass {
 public:
  // Kind `support`, and `contact`, `finite_strain` and `relaxation` if the calibration has them. Errors: kBadInput,
  // kRefused.
  [[nodiscard]] static Result<SecondPass> load(const Calibration& calibration, const BoardSettings& board);

  [[nodiscard]] bool has_memory() const { return relaxation_.has_value(); }
  [[nodiscard]] bool is_at_finite_strain() const { return finite_strain_.has_value(); }

  // `forces`: the linear ones in, with their u, mask and threshold; refined out.
  void refine(bool is_light_steady, SolvedForces& forces, SaturationCounter& saturations);
  // Of the last refine(), of its `forces`; xyz interleaved, 1/64 standard deviation (solve/support_solver.h).
  void leave(const SolvedForces& forces, std::span<int32_t> residual, SaturationCounter& saturations);
  void remember(uint64_t capture_us, SolvedForces& forces, SaturationCounter& saturations);
  // What was done to the pad before.
  void forget();

 private:
  explicit SecondPass(const BoardSettings& board);
  std::span<const NodeForce> add_finite_strain(bool is_light_steady, SolvedForces& forces,
                                               SaturationCounter& saturations);

  GridSize nodes_;
  ContactMask mask_;  // of the forces with what finite strain adds
  std::optional<SupportSolver> support_;
  std::vector<int32_t> left_at_sides_;  // of CameraMotion::unknowns()
  std::optional<SpreadCheck> spread_check_;
  bool has_rim_gauge_;  // depth is zero on the rim, on average
  std::optional<FiniteStrain> finite_strain_;
  std::optional<Relaxation> relaxation_;
};

}  // namespace ruffini
