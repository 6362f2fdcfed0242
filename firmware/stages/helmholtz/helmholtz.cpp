#include "stages/helmholtz/helmholtz.h"

#include <algorithm>
#include <bit>
#include <cstdlib>

#include "image/lanes_scalar.h"
#include "image/trigonometry.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxFlowQ4 = 1 << 18;
constexpr int kRhoFraction = 14;
constexpr int kFactorFraction = 28;
constexpr int64_t kReach = 2;  // steps along x
constexpr int kRoomBits = 29;  // for n_x n_y times the largest value of a transform

// sin^2(pi k / n), Q30.
int64_t sine_square_q30(int k, int n) {
  const int64_t sine = cos_pi_q30(std::abs(n - 2 * k), 2 * n);
  return round_shift(sine * sine, 30);
}

// x 2^shift, half up.
int64_t scaled(int64_t x, int shift) { return shift >= 0 ? x << shift : round_shift(x, -shift); }

}  // namespace

Helmholtz::Helmholtz(const BoardSettings& board)
    : lattice_(board.markers.lattice),
      pitch_x_um_(board.markers.pitch_x_um),
      pitch_y_um_(board.markers.pitch_y_um),
      twice_first_x_um_(2 * board.markers.first_x_um - board.pad.size_x_um),
      twice_first_y_um_(2 * board.markers.first_y_um - board.pad.size_y_um),
      rho_q14_(floor_div(2 * (pitch_x_um_ << kRhoFraction) + pitch_y_um_, 2 * pitch_y_um_)),
      along_x_(lattice_.n_x),
      along_y_(lattice_.n_y),
      factor_q28_(static_cast<size_t>(lattice_.count())),
      wide_(factor_q28_.size()),
      plane_(factor_q28_.size()),
      line_(5 * static_cast<size_t>(std::max(lattice_.n_x, lattice_.n_y))),
      u_(factor_q28_.size()),
      gradient_(factor_q28_.size()) {
  const int64_t rho_square_q28 = rho_q14_ * rho_q14_;
  for (int y = 0; y < lattice_.n_y; ++y) {
    for (int x = 0; x < lattice_.n_x; ++x) {
      if (x == 0 && y == 0) continue;
      const int64_t wave_q30 = sine_square_q30(x, lattice_.n_x) +
                               round_shift(round_shift(sine_square_q30(y, lattice_.n_y), 2) * rho_square_q28, 26);
      // Scale of the inverse transforms: 2 / n along an axis, half of it for the mean.
      const int64_t weight = (x == 0 ? 1 : 2) * (y == 0 ? 1 : 2);
      factor_q28_[at(x, y)] = floor_div(weight << (30 + kFactorFraction - 1), wave_q30 * lattice_.count());
    }
  }
}

void Helmholtz::load_clamped(std::span<const FlowPoint> flow, SaturationCounter& saturations) {
  const auto held = [&](int64_t v) {
    const int64_t out = std::clamp(v, -kMaxFlowQ4, kMaxFlowQ4);
    saturations.count += out == v ? 0 : 1;
    return out;
  };
  std::transform(flow.begin(), flow.end(), u_.begin(),
                 [&](const FlowPoint& u) { return FlowPoint{held(u.x_q4), held(u.y_q4)}; });
}

void Helmholtz::find_divergence() {
  const int last_x = lattice_.n_x - 1;
  const int last_y = lattice_.n_y - 1;
  for (int y = 0; y <= last_y; ++y) {
    const int above = std::max(y - 1, 0);
    const int below = std::min(y + 1, last_y);
    for (int x = 0; x <= last_x; ++x) {
      const int left = std::max(x - 1, 0);
      const int right = std::min(x + 1, last_x);
      const int64_t along_x = (u_[at(right, y)].x_q4 - u_[at(left, y)].x_q4) * (right - left == 1 ? 2 : 1);
      const int64_t along_y = (u_[at(x, below)].y_q4 - u_[at(x, above)].y_q4) * (below - above == 1 ? 2 : 1);
      wide_[at(x, y)] = along_x + round_shift(along_y * rho_q14_, kRhoFraction);
    }
  }
}

int Helmholtz::normalize() {
  int64_t largest = 0;
  for (const int64_t v : wide_) largest = std::max(largest, std::abs(v));
  const int bits = static_cast<int>(std::bit_width(static_cast<uint64_t>(largest))) +
                   static_cast<int>(std::bit_width(static_cast<uint64_t>(lattice_.count())));
  const int shift = largest == 0 ? 0 : kRoomBits - bits;
  std::transform(wide_.begin(), wide_.end(), plane_.begin(),
                 [&](int64_t v) { return static_cast<int32_t>(scaled(v, shift)); });
  return shift;
}

void Helmholtz::solve() {
  const CosineTransform<ScalarLanes> rows(along_x_);
  const CosineTransform<ScalarLanes> columns(along_y_);
  const int n_x = lattice_.n_x;
  const int n_y = lattice_.n_y;
  int32_t* in = line_.data();
  int32_t* out = in + std::max(n_x, n_y);
  int32_t* work = out + std::max(n_x, n_y);
  const auto each_line = [&](bool is_forward) {
    for (int y = 0; y < n_y; ++y) {
      int32_t* row = &plane_[at(0, y)];
      is_forward ? rows.forward(row, out, work) : rows.inverse(row, out, work);
      std::copy_n(out, n_x, row);
    }
    for (int x = 0; x < n_x; ++x) {
      for (int y = 0; y < n_y; ++y) in[y] = plane_[at(x, y)];
      is_forward ? columns.forward(in, out, work) : columns.inverse(in, out, work);
      for (int y = 0; y < n_y; ++y) plane_[at(x, y)] = out[y];
    }
  };
  const int up = normalize();
  each_line(true);
  std::transform(plane_.begin(), plane_.end(), factor_q28_.begin(), wide_.begin(),
                 [](int32_t f, int64_t factor) { return -f * factor; });
  const int up_again = normalize();
  each_line(false);
  scale_ = -(up + kFactorFraction + up_again);
}

void Helmholtz::find_gradient() {
  const int last_x = lattice_.n_x - 1;
  const int last_y = lattice_.n_y - 1;
  for (int y = 0; y <= last_y; ++y) {
    const int above = std::max(y - 1, 0);
    const int below = std::min(y + 1, last_y);
    for (int x = 0; x <= last_x; ++x) {
      const int64_t along_x = int64_t{plane_[at(std::min(x + 1, last_x), y)]} - plane_[at(std::max(x - 1, 0), y)];
      const int64_t along_y = int64_t{plane_[at(x, below)]} - plane_[at(x, above)];
      gradient_[at(x, y)] = {scaled(along_x, scale_ - 1),
                             scaled(round_shift(along_y * rho_q14_, kRhoFraction), scale_ - 1)};
    }
  }
}

void Helmholtz::sum_up() {
  int64_t curl_free = 0;
  FlowPoint rest;
  for (size_t i = 0; i < u_.size(); ++i) {
    const FlowPoint& g = gradient_[i];
    curl_free += floor_sqrt(g.x_q4 * g.x_q4 + g.y_q4 * g.y_q4);
    rest.x_q4 += u_[i].x_q4 - g.x_q4;
    rest.y_q4 += u_[i].y_q4 - g.y_q4;
  }
  const auto n = static_cast<int64_t>(u_.size());
  sums_.curl_free_q4 = curl_free / n;
  sums_.divergence_free_q4 = floor_sqrt(rest.x_q4 * rest.x_q4 + rest.y_q4 * rest.y_q4) / n;
}

int64_t Helmholtz::twist_urad(const Profile& profile) const {
  const int64_t twice_reach = 2 * kReach * pitch_x_um_;
  int64_t x_along_y = 0;
  int64_t y_along_x = 0;
  int64_t n = 0;
  for (int y = 1; y + 1 < lattice_.n_y; ++y) {
    const int64_t dy = twice_first_y_um_ + 2 * (y * pitch_y_um_ - profile.center_y_um);
    for (int x = 1; x + 1 < lattice_.n_x; ++x) {
      const int64_t dx = twice_first_x_um_ + 2 * (x * pitch_x_um_ - profile.center_x_um);
      if (dx * dx + dy * dy > twice_reach * twice_reach) continue;
      y_along_x += u_[at(x + 1, y)].y_q4 - u_[at(x - 1, y)].y_q4;
      x_along_y += u_[at(x, y + 1)].x_q4 - u_[at(x, y - 1)].x_q4;
      ++n;
    }
  }
  if (n == 0) return 0;
  // 1/16 um over two steps, and half of it.
  return floor_div(y_along_x * 1'000'000, 64 * pitch_x_um_ * n) -
         floor_div(x_along_y * 1'000'000, 64 * pitch_y_um_ * n);
}

const HelmholtzSums& Helmholtz::run(std::span<const FlowPoint> flow, const Profile& profile,
                                    SaturationCounter& saturations) {
  load_clamped(flow, saturations);
  find_divergence();
  solve();
  find_gradient();
  sum_up();
  sums_.twist_urad = twist_urad(profile);
  return sums_;
}

}  // namespace ruffini
