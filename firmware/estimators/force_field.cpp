#include "estimators/force_field.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <iterator>
#include <utility>

namespace ruffini {
namespace {

// All of them, or none: then uncertainty is not measured.
constexpr std::array kErrorTensors = {"support.error_reported", "support.error_quiet", "support.error_local",
                                      "support.error_wrench"};

// The u_z of an outlier stays unless it is off by twice what u_x and u_y may be: depth often has another source.
constexpr int32_t kDepthOverShear = 2;

constexpr const char* kStiffnessSigma = "support.stiffness_sigma_1e6";
constexpr int64_t kMaxStiffnessSigma_1e6 = 500'000;
// What is touched on more than five sixteenths of its nodes shows too little rest beside it to measure depth from.
bool covers_pad(std::span<const uint8_t> mask) {
  return 16 * std::count_if(mask.begin(), mask.end(), [](uint8_t m) { return m != 0; }) > 5 * std::ssize(mask);
}

}  // namespace

ForceField::ForceField(const BoardSettings& board, const NodeGrid& nodes)
    : pad_(board.pad),
      nodes_(nodes.size()),
      places_(nodes.places()),
      force_lsb_un_(board.force_lsb_un),
      contact_threshold_lsb_(contact_threshold_lsb(board.contact.threshold_un, board.force_lsb_un)),
      mask_(nodes_, contact_threshold_lsb_, board.contact.min_nodes),
      repair_(nodes_),
      least_outlier_q3_(FieldRepair::least_q3(board.pad.size_x_um / (board.grid.n_x - 1),
                                              board.pad.size_y_um / (board.grid.n_y - 1), board.pad.thickness_um)),
      repaired_(static_cast<size_t>(nodes_.count())),
      camera_motion_(nodes_),
      left_at_sides_(camera_motion_.unknowns().size()),
      has_rim_gauge_(board.depth.source == DepthSource::kLight && board.depth.gauge == Gauge::kMargin) {}

Status ForceField::load(const Calibration& calibration, bool has_operator, bool has_second_pass) {
  if (!has_operator || !calibration.has_kind("operator")) return Unit{};
  if (Status loaded = load_operator(calibration); !loaded) return loaded;
  if (calibration.has_kind("contact")) {
    if (Status noise = mask_.load_noise(calibration, force_lsb_un_); !noise) return noise;
  }
  if (!has_second_pass || !calibration.has_kind("support")) return Unit{};
  return load_second_pass(calibration);
}

Status ForceField::load_operator(const Calibration& calibration) {
  const int n = 3 * nodes_.count();
  const std::pair<const char*, int64_t> expected[] = {{"operator.n_x", nodes_.n_x},
                                                      {"operator.n_y", nodes_.n_y},
                                                      {"operator.force_lsb_un", force_lsb_un_},
                                                      {"operator.displacement_lsb_nm", kDisplacementLsbNm}};
  for (const auto& [key, value] : expected) {
    const auto found = calibration.integer(key, value, value);
    if (!found) return found.error();
  }
  return keep(BlockProgram::load(calibration, "operator", n, n), operator_);
}

Status ForceField::load_second_pass(const Calibration& calibration) {
  if (Status loaded = keep(SupportSolver::load(calibration, nodes_, places_), support_); !loaded) return loaded;
  support_->watch(camera_motion_.unknowns());
  if (Status loaded = load_error_model(calibration); !loaded) return loaded;
  if (calibration.tensor("support.spread") != nullptr) {
    if (Status loaded = keep(SpreadCheck::load(calibration, nodes_, places_), spread_check_); !loaded) return loaded;
  }
  if (calibration.has_kind("finite_strain")) {
    if (Status loaded = keep(FiniteStrain::load(calibration, nodes_), finite_strain_); !loaded) return loaded;
  }
  if (!calibration.has_kind("relaxation")) return Unit{};
  return keep(Relaxation::load(calibration, nodes_.count()), relaxation_);
}

Status ForceField::load_error_model(const Calibration& calibration) {
  const auto is_there = [&](const char* name) { return calibration.tensor(name) != nullptr; };
  if (std::none_of(kErrorTensors.begin(), kErrorTensors.end(), is_there)) return Unit{};
  int64_t stiffness_1e6 = pad_.stiffness_sigma_1e3 * 1'000;
  if (!calibration.text(kStiffnessSigma).empty()) {
    const auto stated = calibration.integer(kStiffnessSigma, 0, kMaxStiffnessSigma_1e6);
    if (!stated) return stated.error();
    stiffness_1e6 = stated.value();
  }
  const int64_t stiffness_q20 = (stiffness_1e6 << 20) / 1'000'000;
  Status nodes = keep(NodeSigmaModel::load(calibration, nodes_, contact_threshold_lsb_, stiffness_q20), node_error_);
  return nodes ? keep(WrenchErrorModel::load(calibration, pad_, stiffness_q20), wrench_error_) : nodes;
}

void ForceField::prepare(SolvedForces& out) {
  const auto n_nodes = static_cast<size_t>(nodes_.count());
  out.u.resize(3 * n_nodes);
  out.wide.resize(3 * n_nodes);
  out.force.resize(n_nodes);
  out.mask = mask_.find(out.force);
}

void ForceField::repair(std::span<NodeDisplacement> displacement, std::span<uint8_t> is_filled) {
  const auto is_measured = [](const NodeDisplacement& u) {
    return u.x.raw() != kNotMeasured && u.y.raw() != kNotMeasured && u.z.raw() != kNotMeasured;
  };
  for (size_t i = 0; i < displacement.size(); ++i) {
    const NodeDisplacement& u = displacement[i];
    is_filled[i] = is_measured(u) ? 0 : 1;
    repaired_[i] = is_measured(u) ? FieldValue{u.x.raw(), u.y.raw(), u.z.raw()} : FieldValue{};
  }
  repair_.run(repaired_, is_filled, least_outlier_q3_);
  for (size_t i = 0; i < displacement.size(); ++i) {
    if (is_filled[i] == 0) continue;
    NodeDisplacement& u = displacement[i];
    const auto um = [](int32_t q3) { return DisplacementUm::from_raw(static_cast<int16_t>(q3)); };
    const bool is_depth_good = is_filled[i] == FieldRepair::kOutlier &&
                               std::abs(u.z.raw() - repaired_[i].z) <= kDepthOverShear * least_outlier_q3_;
    u = {um(repaired_[i].x), um(repaired_[i].y), is_depth_good ? u.z : um(repaired_[i].z)};
    is_filled[i] = 1;
  }
}

void ForceField::estimate(std::span<const NodeDisplacement> displacement, bool is_light_steady, SolvedForces& out,
                          SaturationCounter& saturations) {
  for (size_t i = 0; i < displacement.size(); ++i) {
    out.u[3 * i] = displacement[i].x.raw();
    out.u[3 * i + 1] = displacement[i].y.raw();
    out.u[3 * i + 2] = displacement[i].z.raw();
  }
  operator_->run(out.u, out.wide);
  const auto row = [&](size_t r) { return saturate_raw<int32_t>(out.wide[r], saturations); };
  for (size_t i = 0; i < out.force.size(); ++i) out.force[i] = {row(3 * i), row(3 * i + 1), row(3 * i + 2)};
  out.mask = mask_.find(out.force, is_light_steady);
}

void ForceField::refine(bool is_light_steady, SolvedForces& out, SaturationCounter& saturations) {
  const std::span<const NodeForce> beyond = add_finite_strain(is_light_steady, out, saturations);
  const bool is_pressed = mask_.is_pressed();
  support_->run(out.u, beyond, out.mask, mask_.threshold_lsb(), out.force, saturations);
  if (!spread_check_) return;
  out.is_explained =
      spread_check_->is_explained(out.u, out.force, beyond, is_pressed) &&
      !(has_rim_gauge_ && (covers_pad(out.mask) || is_rim_pressed(nodes_, out.force, mask_.threshold_lsb())));
}

void ForceField::leave(const SolvedForces& solved, std::span<int32_t> residual, SaturationCounter& saturations) {
  support_->leave(solved.u, residual, saturations);
}

bool ForceField::has_camera_moved(const SolvedForces& solved, const Wrench& wrench) {
  support_->leave_watched(left_at_sides_);
  return camera_motion_.is_moved(left_at_sides_, solved.mask, wrench);
}

// To the linear estimate, and so to the mask. What it added; empty where nothing touches or the calibration is linear.
std::span<const NodeForce> ForceField::add_finite_strain(bool is_light_steady, SolvedForces& out,
                                                         SaturationCounter& saturations) {
  const auto is_touched = [](uint8_t m) { return m != 0; };
  if (!finite_strain_ || std::none_of(out.mask.begin(), out.mask.end(), is_touched)) return {};
  const std::span<const NodeForce> beyond = finite_strain_->run(out.u, saturations);
  const auto add = [&](int32_t a, int32_t b) { return saturate_raw<int32_t>(int64_t{a} + b, saturations); };
  for (size_t i = 0; i < beyond.size(); ++i) {
    NodeForce& f = out.force[i];
    f = {add(f.x, beyond[i].x), add(f.y, beyond[i].y), add(f.z, beyond[i].z)};
  }
  out.mask = mask_.find(out.force, is_light_steady);
  return beyond;
}

void ForceField::remember(uint64_t capture_us, SolvedForces& out, SaturationCounter& saturations) {
  relaxation_->run(capture_us, out.mask, out.force, saturations);
}

void ForceField::forget() {
  if (relaxation_) relaxation_->forget();
}

void ForceField::state_sigma(const SolvedForces& solved, std::span<const uint8_t> is_filled,
                             std::span<NodeSigma> sigma) {
  node_error_->run(solved.force, is_filled, sigma);
}

WrenchCovariance ForceField::state_covariance(const SolvedForces& solved, std::span<const uint8_t> is_filled,
                                              const Wrench& wrench, const ContactList& contacts) const {
  return wrench_error_->run(wrench, contacts, count_touched(solved.mask, is_filled));
}

}  // namespace ruffini
