#include "solve/support_solver.h"

#include <algorithm>
#include <numeric>

#include "solve/block_float.h"

namespace ruffini {
namespace {

using namespace block_float;

constexpr int64_t kImageLimit = int64_t{1} << 33;  // clamp of H p16: its energy over 2^14 unknowns stays below 2^62
constexpr int kImageFraction = 8;
constexpr int kForceFraction = 30;
constexpr int kUnitFraction = 14;  // of y and r
constexpr int kSizeFraction = 12;
constexpr int64_t kUnitSize = int64_t{1} << kSizeFraction;
constexpr int64_t kMaxSize = 4;
constexpr int64_t kMaxNoise = int64_t{1} << 24;

bool is_shear(uint32_t unknown) { return unknown % 3 != 2; }

}  // namespace

Result<SupportSolver> SupportSolver::load(const Calibration& calibration, GridSize nodes,
                                          std::span<const NodePlace> places) {
  const int n = 3 * nodes.count();
  auto normal = BlockProgram::load(calibration, "support.normal", n, n);
  if (!normal) return normal.error();
  auto project = BlockProgram::load(calibration, "support.project", n, n);
  if (!project) return project.error();
  auto scale = calibration.tensor("support.scale", Tensor::Type::kI32, {n});
  if (!scale) return scale.error();
  auto noise = calibration.integer("support.shear_noise", 0, kMaxNoise);
  if (!noise) return noise.error();
  SupportSolver out(ShearModes(nodes, places, noise.value()));
  out.normal_ = std::move(normal).value();
  out.project_ = std::move(project).value();
  out.scale_ = scale.value()->as<int32_t>();
  for (const int32_t d : out.scale_) {
    if (d <= 0) return Error{ErrorKind::kBadInput, "calibration file: support.scale is not positive: make it again"};
  }
  const auto size = static_cast<size_t>(n);
  out.index_.reserve(size);
  out.selected_.reserve(size);
  out.p16_.resize(size);
  out.wide_.resize(size);
  out.beyond_.resize(size);
  out.residual_.resize(size);
  out.all_.resize(size);
  std::iota(out.all_.begin(), out.all_.end(), 0U);
  for (auto* values :
       {&out.weight_, &out.b_, &out.evidence_, &out.y_, &out.r_, &out.v_, &out.z_, &out.p_, &out.image_}) {
    values->reserve(size);
  }
  return out;
}

void SupportSolver::gather(std::span<const uint8_t> mask) {
  index_.clear();
  weight_.clear();
  for (uint32_t node = 0; node < mask.size(); ++node) {
    if (mask[node] == 0) continue;
    for (uint32_t c = 0; c < 3; ++c) {
      index_.push_back(3 * node + c);
      weight_.push_back(mask[node]);
    }
  }
  selected_.assign(index_.begin(), index_.end());
  for (const Watched& w : watched_) {
    if (mask[w.unknown / 3] == 0) selected_.push_back(w.unknown);
  }
  project_.select(selected_);
}

int SupportSolver::spread(std::span<const int64_t> values) {
  const int shift = common_shift(values);
  for (size_t i = 0; i < index_.size(); ++i) p16_[index_[i]] = static_cast<int16_t>(to_16(values[i], shift));
  return shift;
}

void SupportSolver::multiply(SaturationCounter& saturations) {
  image_.resize(index_.size());
  normal_.run(p16_, wide_);
  for (size_t i = 0; i < index_.size(); ++i) image_[i] = clamp_counted(wide_[index_[i]], saturations, kImageLimit);
  for (Watched& w : watched_) w.image = clamp_counted(wide_[w.unknown], watched_saturations_, kImageLimit);
}

// y = w times the linear estimate; computes b.
void SupportSolver::start(std::span<const int16_t> u, std::span<const NodeForce> force,
                          SaturationCounter& saturations) {
  y_.resize(index_.size());
  b_.resize(index_.size());
  r_.resize(index_.size());
  v_.resize(index_.size());
  z_.resize(index_.size());
  p_.resize(index_.size());
  project_.run(u, wide_);
  for (Watched& w : watched_) w.b = wide_[w.unknown];
  for (size_t i = 0; i < index_.size(); ++i) {
    const NodeForce& f = force[index_[i] / 3];
    const int64_t value = index_[i] % 3 == 0 ? f.x : index_[i] % 3 == 1 ? f.y : f.z;
    const int64_t y = clamp_counted(floor_div(value * (int64_t{1} << kForceFraction), scale_[index_[i]]), saturations);
    y_[i] = round_shift(weight_[i] * y, ContactMask::kFraction);
    b_[i] = wide_[index_[i]];
  }
  evidence_.assign(b_.begin(), b_.end());
}

// H (beyond / d) at all nodes, since the finite-strain part is not zero outside the support.
void SupportSolver::add_to_b(std::span<const NodeForce> beyond, SaturationCounter& saturations) {
  for (size_t i = 0; i < beyond_.size(); ++i) {
    const NodeForce& f = beyond[i / 3];
    const int64_t value = i % 3 == 0 ? f.x : i % 3 == 1 ? f.y : f.z;
    beyond_[i] = clamp_counted(floor_div(value * (int64_t{1} << kForceFraction), scale_[i]), saturations);
  }
  const int shift = common_shift(beyond_);
  std::transform(beyond_.begin(), beyond_.end(), p16_.begin(),
                 [&](int64_t v) { return static_cast<int16_t>(to_16(v, shift)); });
  normal_.select(selected_);
  multiply(saturations);
  for (size_t i = 0; i < index_.size(); ++i) b_[i] += shift_saturating(image_[i], kImageFraction - shift);
  for (Watched& w : watched_) w.b += shift_saturating(w.image, kImageFraction - shift);
  std::fill(p16_.begin(), p16_.end(), int16_t{0});
}

// Multiplies w and y by clamp(-f_z / T, 0, 1), node by node: index_ holds x, y, z of each node in turn.
void SupportSolver::weaken_pull(int64_t threshold_lsb) {
  for (size_t i = 0; i < index_.size(); i += 3) {
    const int64_t pressure = -round_shift(y_[i + 2] * scale_[index_[i + 2]], kForceFraction);
    const int64_t keep = std::clamp<int64_t>(pressure, 0, threshold_lsb) * ContactMask::kFull / threshold_lsb;
    for (size_t c = i; c < i + 3; ++c) {
      weight_[c] = (weight_[c] * keep) >> ContactMask::kFraction;
      y_[c] = round_shift(y_[c] * keep, ContactMask::kFraction);
    }
  }
}

// z = M r with M = w^2, a quarter of that for shear, plus the shear modes. Returns r . z.
SupportSolver::Energy SupportSolver::precondition() {
  for (size_t i = 0; i < index_.size(); ++i) {
    const int shift = ContactMask::kFraction + (is_shear(index_[i]) ? 1 : 0);
    v_[i] = round_shift(weight_[i] * r_[i], shift);
    z_[i] = round_shift(weight_[i] * v_[i], shift);
  }
  Energy out{0, common_shift(v_)};
  for (const int64_t v : v_) out.sum += to_16(v, out.shift) * to_16(v, out.shift);
  out.sum += modes_.precondition(r_, z_, out.shift);
  return out;
}

// Returns the factor by which y = p16 2^shift, whose image is computed, explains b best.
int64_t SupportSolver::size_q12(int shift) const {
  const int b_shift = common_shift(b_);
  int64_t explained = 0;  // p16 . b16
  int64_t curvature = 0;  // p16 . H p16, with kImageFraction bits
  for (size_t i = 0; i < index_.size(); ++i) {
    explained += p16_[index_[i]] * to_16(b_[i], b_shift);
    curvature += p16_[index_[i]] * image_[i];
  }
  if (explained <= 0 || curvature <= 0) return kUnitSize;
  const Quotient size = quotient(explained, curvature, b_shift - shift + kImageFraction);
  return std::clamp(shift_saturating(size.mantissa, -(size.exponent + kSizeFraction)), kUnitSize / kMaxSize,
                    kUnitSize * kMaxSize);
}

// y = s y in the first round, r = b - H y; p = z; kSteps conjugate-gradient steps.
void SupportSolver::round(bool is_first, SaturationCounter& saturations) {
  const int shift = spread(y_);
  multiply(saturations);
  const int64_t size = is_first ? size_q12(shift) : kUnitSize;
  for (size_t i = 0; i < index_.size(); ++i) {
    y_[i] = clamp_counted(shift_saturating(p16_[index_[i]] * size, kSizeFraction - shift), saturations);
    r_[i] =
        clamp_counted(b_[i] - shift_saturating(image_[i] * size, kSizeFraction + kImageFraction - shift), saturations);
  }
  for (Watched& w : watched_)
    w.r = clamp_counted(w.b - shift_saturating(w.image, kImageFraction - shift), watched_saturations_);
  Energy current = precondition();
  for (size_t i = 0; i < index_.size(); ++i) p_[i] = clamp_counted(z_[i], saturations);
  for (int i = 0; i < kSteps && current.sum > 0; ++i) {
    if (!step(current, saturations)) break;
  }
}

bool SupportSolver::step(Energy& current, SaturationCounter& saturations) {
  const int shift = spread(p_);
  multiply(saturations);
  int64_t curvature = 0;  // p16 . H p16, with kImageFraction bits
  for (size_t i = 0; i < index_.size(); ++i) curvature += p16_[index_[i]] * image_[i];
  if (curvature <= 0) return false;
  const Quotient step = quotient(current.sum, curvature, 2 * (current.shift - shift) + kImageFraction);
  for (size_t i = 0; i < index_.size(); ++i) {
    y_[i] = clamp_counted(y_[i] + scaled(p16_[index_[i]], step, shift), saturations);
    r_[i] = clamp_counted(r_[i] - scaled(image_[i], step, shift - kImageFraction), saturations);
  }
  for (Watched& w : watched_)
    w.r = clamp_counted(w.r - scaled(w.image, step, shift - kImageFraction), watched_saturations_);
  const Energy next = precondition();
  if (next.sum == 0) return false;
  const Quotient beta = quotient(next.sum, current.sum, 2 * (next.shift - current.shift));
  for (size_t i = 0; i < index_.size(); ++i) {
    p_[i] = clamp_counted(z_[i] + scaled(p_[i], beta, 0), saturations);
  }
  current = next;
  return true;
}

void SupportSolver::run(std::span<const int16_t> u, std::span<const NodeForce> beyond, std::span<const uint8_t> mask,
                        int64_t threshold_lsb, std::span<NodeForce> force, SaturationCounter& saturations) {
  gather(mask);
  std::fill(p16_.begin(), p16_.end(), int16_t{0});
  start(u, force, saturations);
  has_beyond_ = !beyond.empty();
  if (has_beyond_) add_to_b(beyond, saturations);
  std::fill(force.begin(), force.end(), NodeForce{});
  if (index_.empty()) {  // y = 0, so H y = 0
    for (Watched& w : watched_) w.r = clamp_counted(w.b, watched_saturations_);
    return;
  }
  normal_.select(selected_, index_);
  modes_.assign(mask, index_);
  for (int i = 0; i < kRounds; ++i) {
    if (i > 0) weaken_pull(threshold_lsb);
    modes_.learn(y_, weight_);
    if (i == 0) modes_.shrink(y_, weight_);
    round(i == 0, saturations);
  }
  for (size_t i = 0; i < index_.size(); ++i) {
    const auto value = saturate_raw<int32_t>(round_shift(y_[i] * scale_[index_[i]], kForceFraction), saturations);
    NodeForce& f = force[index_[i] / 3];
    (index_[i] % 3 == 0 ? f.x : index_[i] % 3 == 1 ? f.y : f.z) = value;
  }
}

void SupportSolver::watch(std::span<const uint32_t> unknowns) {
  watched_.clear();
  for (const uint32_t j : unknowns) watched_.push_back({.unknown = j});
}

void SupportSolver::watched_residual(std::span<int32_t> residual) const {
  std::transform(watched_.begin(), watched_.end(), residual.begin(), [](const Watched& w) {
    return static_cast<int32_t>(round_shift(w.r, kUnitFraction - kResidualFraction));
  });
}

void SupportSolver::residual(std::span<const int16_t> u, std::span<int32_t> residual, SaturationCounter& saturations) {
  // The linear pad explains y - beyond / d.
  std::fill(residual_.begin(), residual_.end(), int64_t{0});
  if (has_beyond_) std::transform(beyond_.begin(), beyond_.end(), residual_.begin(), [](int64_t v) { return -v; });
  for (size_t i = 0; i < index_.size(); ++i) residual_[index_[i]] += y_[i];
  const int shift = common_shift(residual_);
  std::transform(residual_.begin(), residual_.end(), p16_.begin(),
                 [&](int64_t v) { return static_cast<int16_t>(to_16(v, shift)); });
  normal_.select(all_);
  normal_.run(p16_, wide_);
  std::transform(wide_.begin(), wide_.end(), residual_.begin(), [&](int64_t v) {
    return clamp_counted(shift_saturating(clamp_counted(v, saturations, kImageLimit), kImageFraction - shift),
                         saturations);
  });
  project_.select(all_);
  project_.run(u, wide_);
  for (size_t i = 0; i < residual.size(); ++i) {
    const int64_t left = clamp_counted(wide_[i], saturations) - residual_[i];
    residual[i] = static_cast<int32_t>(round_shift(left, kUnitFraction - kResidualFraction));
  }
}

}  // namespace ruffini
