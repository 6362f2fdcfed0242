// Second pass of the solve: refines the linear nodal forces until they explain the displacement.
//
//   refine             adds the finite-strain part, then least squares in contact (solve/support_solver.h)
//   average            averages the field of a contact that does not change (solve/steady_field.h)
//   apply_relaxation   subtracts what the pad lost to relaxation (solve/relaxation.h)
//   compute_residual   displacement that the refined forces do not explain; only on request
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
#include "solve/steady_field.h"
#include "solve/support_solver.h"
#include "store/calibration.h"

namespace ruffini {

class SecondPass {
 public:
  // Loads kind `support`, and `contact`, `finite_strain` and `relaxation` if the calibration has them. Errors:
  // kBadInput, kRefused.
  [[nodiscard]] static Result<SecondPass> load(const Calibration& calibration, const BoardSettings& board);

  [[nodiscard]] bool has_relaxation() const { return relaxation_.has_value(); }
  [[nodiscard]] bool is_at_finite_strain() const { return finite_strain_.has_value(); }

  // `forces`: the linear ones in, with their u, mask and threshold; the refined ones out.
  void refine(SolvedForces& forces, SaturationCounter& saturations);
  // For the last refine() and its `forces`; xyz interleaved, 1/64 standard deviation (solve/support_solver.h).
  void compute_residual(const SolvedForces& forces, std::span<int32_t> residual, SaturationCounter& saturations);
  // `forces`: from the last refine(). `is_trusted`: the frame may enter the average; otherwise averaging starts again.
  void average(bool is_trusted, SolvedForces& forces, SaturationCounter& saturations);
  void apply_relaxation(uint64_t capture_us, SolvedForces& forces, SaturationCounter& saturations);
  // Averaging starts again with the next frame.
  void distrust();
  // Resets average and relaxation: the pad was never touched.
  void forget();

 private:
  explicit SecondPass(const BoardSettings& board);
  std::span<const NodeForce> add_finite_strain(SolvedForces& forces, SaturationCounter& saturations);

  GridSize nodes_;
  ContactMask mask_;  // of the forces including the finite-strain part
  std::optional<SupportSolver> support_;
  std::vector<int32_t> residual_at_sides_;  // of CameraMotion::unknowns()
  std::optional<SpreadCheck> spread_check_;
  bool has_rim_gauge_;  // depth is zeroed on the mean of the rim
  std::optional<FiniteStrain> finite_strain_;
  std::optional<SteadyField> steady_;  // if the board asks for it
  std::optional<Relaxation> relaxation_;
};

}  // namespace ruffini
