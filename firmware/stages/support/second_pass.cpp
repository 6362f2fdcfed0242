#include "stages/support/second_pass.h"

#include <algorithm>
#include <utility>

namespace ruffini {
namespace {

static_assert(kMaxSteadyFrames == SteadyField::kMaxFrames);

// If more than five sixteenths of the nodes are touched, the remaining pad is too small a reference for depth.
bool covers_pad(std::span<const uint8_t> mask) {
  return 16 * std::count_if(mask.begin(), mask.end(), [](uint8_t m) { return m != 0; }) > 5 * std::ssize(mask);
}

}  // namespace

SecondPass::SecondPass(const BoardSettings& board)
    : nodes_(NodeGrid(board).size()),
      mask_(nodes_, contact_threshold_lsb(board.contact.threshold_un, board.force_lsb_un), board.contact.min_nodes),
      has_rim_gauge_(board.depth.source == DepthSource::kLight && board.depth.gauge == Gauge::kMargin) {}

Result<SecondPass> SecondPass::load(const Calibration& calibration, const BoardSettings& board) {
  SecondPass out(board);
  const std::vector<NodePlace> places = NodeGrid(board).places();
  if (calibration.has_kind("contact")) {
    if (Status noise = out.mask_.load_noise(calibration, board.force_lsb_un); !noise) return noise.error();
  }
  if (Status loaded = keep(SupportSolver::load(calibration, out.nodes_, places), out.support_); !loaded) {
    return loaded.error();
  }
  if (board.contact.steady_frames > 1) out.steady_.emplace(out.nodes_, places, board.contact.steady_frames);
  const CameraMotion sides(out.nodes_);
  out.support_->watch(sides.unknowns());
  out.residual_at_sides_.resize(sides.unknowns().size());
  if (calibration.tensor("support.spread") != nullptr) {
    if (Status loaded = keep(SpreadCheck::load(calibration, out.nodes_, places), out.spread_check_); !loaded) {
      return loaded.error();
    }
  }
  if (calibration.has_kind("finite_strain")) {
    if (Status loaded = keep(FiniteStrain::load(calibration, out.nodes_), out.finite_strain_); !loaded) {
      return loaded.error();
    }
  }
  if (calibration.has_kind("relaxation")) {
    if (Status loaded = keep(Relaxation::load(calibration, out.nodes_.count()), out.relaxation_); !loaded) {
      return loaded.error();
    }
  }
  return out;
}

void SecondPass::refine(SolvedForces& forces, SaturationCounter& saturations) {
  const std::span<const NodeForce> beyond = add_finite_strain(forces, saturations);
  support_->run(forces.u, beyond, forces.mask, forces.threshold_lsb, forces.force, saturations);
  support_->watched_residual(residual_at_sides_);
  forces.residual_at_sides = residual_at_sides_;
  forces.is_refined = true;
  if (!spread_check_) return;
  forces.is_explained =
      spread_check_->is_explained(forces.u, forces.force, beyond, forces.is_pressed) &&
      !(has_rim_gauge_ && (covers_pad(forces.mask) || is_rim_pressed(nodes_, forces.force, forces.threshold_lsb)));
}

void SecondPass::compute_residual(const SolvedForces& forces, std::span<int32_t> residual,
                                  SaturationCounter& saturations) {
  support_->residual(forces.u, residual, saturations);
}

// Adds the finite-strain part to the linear forces, and so to the mask. Returns it; empty without contact or finite
// strain.
std::span<const NodeForce> SecondPass::add_finite_strain(SolvedForces& forces, SaturationCounter& saturations) {
  const auto is_touched = [](uint8_t m) { return m != 0; };
  if (!finite_strain_ || std::none_of(forces.mask.begin(), forces.mask.end(), is_touched)) return {};
  const std::span<const NodeForce> beyond = finite_strain_->run(forces.u, saturations);
  const auto add = [&](int32_t a, int32_t b) { return saturate_raw<int32_t>(int64_t{a} + b, saturations); };
  for (size_t i = 0; i < beyond.size(); ++i) {
    NodeForce& f = forces.force[i];
    f = {add(f.x, beyond[i].x), add(f.y, beyond[i].y), add(f.z, beyond[i].z)};
  }
  forces.mask = mask_.find(forces.force, forces.is_light_steady);
  forces.threshold_lsb = mask_.threshold_lsb();
  forces.is_pressed = mask_.is_pressed();
  return beyond;
}

void SecondPass::average(bool is_trusted, SolvedForces& forces, SaturationCounter& saturations) {
  if (!steady_) return;
  if (!is_trusted) return distrust();
  steady_->run(forces.mask, support_->evidence(), forces.force, saturations);
}

void SecondPass::apply_relaxation(uint64_t capture_us, SolvedForces& forces, SaturationCounter& saturations) {
  relaxation_->run(capture_us, forces.mask, forces.force, saturations);
}

void SecondPass::distrust() {
  if (steady_) steady_->forget();
}

void SecondPass::forget() {
  distrust();
  if (relaxation_) relaxation_->forget();
}

}  // namespace ruffini
