// Displacement of the nodes -> their forces: the inverse FEM, in two passes, with what the calibration adds.
//
//   repair     fills nodes that were not measured or contradict their neighbours (image/field_repair.h); only for nodes
//              given by a caller, since those of the frame path come from markers that were repaired
//   estimate   f = operator u, and where the pad is touched (solve/contact_mask.h)
//   refine     what finite strain adds, then least squares where touched (solve/support_solver.h)
//   remember   what the pad lost to relaxation (solve/relaxation.h)
//   leave      what the refined forces do not explain of the displacement; only where somebody asks
//   state_*    uncertainty of the refined forces; the first pass alone has no error model. To the error model's own terms
//              it adds the relative standard deviation of the pad's stiffness: the calibration's
//              support.stiffness_sigma_1e6, or the board's if the file has none
//
// Everything but the operator is optional. Frame thread; no allocation after load.
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
#include "estimators/wrench_covariance.h"
#include "image/displacement.h"
#include "image/field_repair.h"
#include "solve/block_program.h"
#include "solve/contact_mask.h"
#include "solve/finite_strain.h"
#include "solve/node_sigma.h"
#include "solve/relaxation.h"
#include "solve/spread_check.h"
#include "solve/support_solver.h"
#include "store/calibration.h"

namespace ruffini {

class ForceField {
 public:
  ForceField(const BoardSettings& board, const NodeGrid& nodes);

  // What the calibration has of it, where the board has the stages. Errors: kBadInput, kRefused.
  [[nodiscard]] Status load(const Calibration& calibration, bool has_operator, bool has_second_pass);

  [[nodiscard]] bool is_measured() const { return operator_.has_value(); }
  [[nodiscard]] bool has_second_pass() const { return support_.has_value(); }
  [[nodiscard]] bool has_memory() const { return relaxation_.has_value(); }
  [[nodiscard]] bool has_error_model() const { return node_error_.has_value(); }
  [[nodiscard]] bool is_at_finite_strain() const { return finite_strain_.has_value(); }

  // Buffers for `out`; untouched.
  void prepare(SolvedForces& out);
  // A node of which a component is kNotMeasured is missing. Sets is_filled to 1 where a node is filled, else to 0.
  static constexpr int16_t kNotMeasured = INT16_MIN;
  void repair(std::span<NodeDisplacement> displacement, std::span<uint8_t> is_filled);
  void estimate(std::span<const NodeDisplacement> displacement, bool is_light_steady, SolvedForces& out,
                SaturationCounter& saturations);
  void refine(bool is_light_steady, SolvedForces& out, SaturationCounter& saturations);
  // Of the last refine(), of its `out`; xyz interleaved, 1/64 standard deviation (solve/support_solver.h).
  void leave(const SolvedForces& solved, std::span<int32_t> residual, SaturationCounter& saturations);
  // Of the last refine(), of its `out`, and the wrench of these forces (estimators/camera_motion.h).
  [[nodiscard]] bool has_camera_moved(const SolvedForces& solved, const Wrench& wrench);
  void remember(uint64_t capture_us, SolvedForces& out, SaturationCounter& saturations);
  // What was done to the pad before.
  void forget();
  void state_sigma(const SolvedForces& solved, std::span<const uint8_t> is_filled, std::span<NodeSigma> sigma);
  [[nodiscard]] WrenchCovariance state_covariance(const SolvedForces& solved, std::span<const uint8_t> is_filled,
                                                  const Wrench& wrench, const ContactList& contacts) const;

 private:
  Status load_operator(const Calibration& calibration);
  Status load_second_pass(const Calibration& calibration);
  Status load_error_model(const Calibration& calibration);
  std::span<const NodeForce> add_finite_strain(bool is_light_steady, SolvedForces& out, SaturationCounter& saturations);

  PadSettings pad_;
  GridSize nodes_;
  std::vector<NodePlace> places_;
  int64_t force_lsb_un_;
  int64_t contact_threshold_lsb_;
  ContactMask mask_;
  FieldRepair repair_;
  int32_t least_outlier_q3_;
  std::vector<FieldValue> repaired_;
  std::optional<BlockProgram> operator_;
  std::optional<SupportSolver> support_;
  CameraMotion camera_motion_;
  std::vector<int32_t> left_at_sides_;  // where camera_motion_ looks
  std::optional<SpreadCheck> spread_check_;
  bool has_rim_gauge_;  // depth is zero on the rim, on average
  std::optional<FiniteStrain> finite_strain_;
  std::optional<Relaxation> relaxation_;
  std::optional<NodeSigmaModel> node_error_;
  std::optional<WrenchErrorModel> wrench_error_;
};

}  // namespace ruffini
