#include "solve/shear_modes.h"

#include <algorithm>

#include "solve/block_float.h"

namespace ruffini {
namespace {

using namespace block_float;

constexpr int kWeightFraction = 7;
constexpr int64_t kFull = int64_t{1} << kWeightFraction;
constexpr int kOrthogonalFraction = 8;              // fraction bits kept during orthogonalization
constexpr int64_t kMinShare = 32;                   // a mode is kept if at least 1 / share of its square remains
constexpr int kDotBits = 38;                        // of a factor of `scaled`
constexpr int64_t kEnergyLimit = int64_t{1} << 54;  // of one mode: 96 of them stay below 2^61

// values -= b (b . values) / norm; |values| < 2^32, so that the sum stays below 2^15 2^32 2^14.
void take_out(std::span<const int16_t> b, int64_t norm, std::span<int64_t> values) {
  int64_t dot = 0;
  for (size_t i = 0; i < b.size(); ++i) dot += b[i] * values[i];
  if (dot == 0 || norm <= 0) return;
  const Quotient part = quotient(dot < 0 ? -dot : dot, norm, 0);
  for (size_t i = 0; i < b.size(); ++i) {
    const int64_t step = scaled(b[i], part, 0);
    values[i] -= dot < 0 ? -step : step;
  }
}

int64_t squares(std::span<const int64_t> values, int shift) {
  int64_t sum = 0;
  for (const int64_t v : values) sum += to_16(v, shift) * to_16(v, shift);
  return sum;
}

void to_16_bits(std::span<int64_t> values) {
  const int shift = common_shift(values);
  for (int64_t& v : values) v = to_16(v, shift);
}

}  // namespace

ShearModes::ShearModes(GridSize nodes, std::span<const NodePlace> places, int64_t noise_y)
    : places_(places.begin(), places.end()), noise_y_(noise_y), components_(nodes) {
  const size_t n = places.size();
  for (Contact& c : contacts_) {
    c.node.reserve(n);
    c.modes.reserve(2 * n * kModes);
  }
  for (auto* values : {&shape_.pressure, &shape_.weight, &shape_.bulge, &shape_.x_um, &shape_.y_um}) values->reserve(n);
  support_node_.reserve(n);
  vector_.reserve(2 * n);
  residual_.reserve(2 * n);
}

void ShearModes::assign(std::span<const uint8_t> mask, std::span<const uint32_t> index) {
  const std::span<const uint16_t> label = components_.find(mask);
  n_contacts_ = std::min(components_.count(), kMaxContacts);
  for (Contact& c : contacts_) c.node.clear();
  support_node_.clear();
  for (uint32_t k = 0; 3 * k < index.size(); ++k) {
    const uint32_t node = index[3 * k] / 3;
    support_node_.push_back(node);
    if (label[node] <= kMaxContacts) contacts_[label[node] - 1U].node.push_back(k);
  }
}

// Scales amplitudes to at most 30 bits, and positions relative to the centre of pressure. Returns false if nothing
// presses.
bool ShearModes::measure(const Contact& contact, std::span<const int64_t> y, std::span<const int64_t> weight) {
  const size_t n = contact.node.size();
  for (auto* values : {&shape_.pressure, &shape_.weight, &shape_.bulge, &shape_.x_um, &shape_.y_um}) values->resize(n);
  for (size_t i = 0; i < n; ++i) {
    const size_t k = contact.node[i];
    shape_.pressure[i] = std::max<int64_t>(-y[3 * k + 2], 0);
    shape_.weight[i] = weight[3 * k];
  }
  to_16_bits(shape_.pressure);
  int64_t total = 0;
  int64_t moment_x = 0;
  int64_t moment_y = 0;
  for (size_t i = 0; i < n; ++i) {
    const NodePlace& place = places_[support_node_[contact.node[i]]];
    total += shape_.pressure[i];
    moment_x += shape_.pressure[i] * place.x_um;
    moment_y += shape_.pressure[i] * place.y_um;
  }
  if (total == 0) return false;
  for (size_t i = 0; i < n; ++i) {
    const NodePlace& place = places_[support_node_[contact.node[i]]];
    shape_.x_um[i] = place.x_um - floor_div(moment_x, total);
    shape_.y_um[i] = place.y_um - floor_div(moment_y, total);
    shape_.bulge[i] = shape_.x_um[i] * shape_.x_um[i] + shape_.y_um[i] * shape_.y_um[i];
  }
  to_16_bits(shape_.bulge);
  for (size_t i = 0; i < n; ++i) shape_.bulge[i] *= shape_.pressure[i];
  return true;
}

void ShearModes::pattern(const Contact& contact, std::span<const int64_t> amplitude, int direction) {
  const size_t n = contact.node.size();
  vector_.resize(2 * n);
  for (size_t i = 0; i < n; ++i) {
    const int64_t x = shape_.x_um[i];
    const int64_t y = shape_.y_um[i];
    const std::array<int64_t, 2> along[] = {{1, 0}, {0, 1}, {-y, x}, {x, y}};
    vector_[2 * i] = amplitude[i] * along[direction][0];
    vector_[2 * i + 1] = amplitude[i] * along[direction][1];
  }
  to_16_bits(vector_);
}

void ShearModes::append(Contact& contact) {
  const size_t size = vector_.size();
  const int64_t before = squares(vector_, 0);
  for (int64_t& v : vector_) v *= int64_t{1} << kOrthogonalFraction;
  for (int j = 0; j < contact.n_modes; ++j) {
    const auto at = static_cast<size_t>(j);
    take_out({contact.modes.data() + at * size, size}, contact.norm[at], vector_);
  }
  if (before == 0 || squares(vector_, kOrthogonalFraction) * kMinShare < before) return;
  to_16_bits(vector_);
  for (const int64_t v : vector_) contact.modes.push_back(static_cast<int16_t>(v));
  contact.norm[static_cast<size_t>(contact.n_modes)] = squares(vector_, 0);
  ++contact.n_modes;
}

void ShearModes::learn(std::span<const int64_t> y, std::span<const int64_t> weight) {
  for (int c = 0; c < n_contacts_; ++c) {
    Contact& contact = contacts_[static_cast<size_t>(c)];
    contact.modes.clear();
    contact.n_modes = 0;
    if (!measure(contact, y, weight)) continue;
    for (const auto* amplitude : {&shape_.pressure, &shape_.weight, &shape_.bulge}) {
      for (int direction = 0; direction < 4; ++direction) {
        pattern(contact, *amplitude, direction);
        append(contact);
      }
    }
  }
}

void ShearModes::shrink(std::span<int64_t> y, std::span<const int64_t> weight) const {
  for (int c = 0; c < n_contacts_; ++c) shrink(contacts_[static_cast<size_t>(c)], y, weight);
}

void ShearModes::shrink(const Contact& contact, std::span<int64_t> y, std::span<const int64_t> weight) const {
  residual_.clear();
  int64_t weight_squares = 0;
  for (const uint32_t k : contact.node) {
    residual_.insert(residual_.end(), {y[3 * k], y[3 * k + 1]});
    weight_squares += 2 * weight[3 * k] * weight[3 * k];
  }
  for (int j = 0; j < contact.n_modes; ++j) {
    const auto at = static_cast<size_t>(j);
    take_out({contact.modes.data() + at * residual_.size(), residual_.size()}, contact.norm[at], residual_);
  }
  const int shift = common_shift(residual_);
  const int64_t energy = squares(residual_, shift);
  const int64_t noise = shift_saturating(noise_y_ * noise_y_ * (weight_squares >> (2 * kWeightFraction)), 2 * shift);
  if (energy == 0) return;
  const int64_t lost = noise >= energy ? kFull : std::min(kNoiseShare * noise / energy, kFull);
  for (size_t i = 0; i < contact.node.size(); ++i) {
    const size_t k = contact.node[i];
    y[3 * k] -= round_shift(residual_[2 * i] * lost, kWeightFraction);
    y[3 * k + 1] -= round_shift(residual_[2 * i + 1] * lost, kWeightFraction);
  }
}

// r| < 2^32 and, by Cauchy-Schwarz, the vector added to z stays below 2^32 times the square root of the support's size.
int64_t ShearModes::precondition(std::span<const int64_t> r, std::span<int64_t> z, int energy_shift) const {
  int64_t energy = 0;
  for (int c = 0; c < n_contacts_; ++c) {
    const Contact& contact = contacts_[static_cast<size_t>(c)];
    const size_t n = contact.node.size();
    for (int j = 0; j < contact.n_modes; ++j) {
      const int16_t* b = contact.modes.data() + static_cast<size_t>(j) * 2 * n;
      int64_t dot = 0;
      for (size_t i = 0; i < n; ++i) {
        const size_t k = contact.node[i];
        dot += b[2 * i] * r[3 * k] + b[2 * i + 1] * r[3 * k + 1];
      }
      const int64_t norm = contact.norm[static_cast<size_t>(j)];
      if (dot == 0 || norm <= 0) continue;
      const int64_t size = dot < 0 ? -dot : dot;
      const Quotient part = quotient(size, norm, kGainShift);
      for (size_t i = 0; i < n; ++i) {
        const size_t k = contact.node[i];
        const int64_t x = scaled(b[2 * i], part, 0);
        const int64_t y = scaled(b[2 * i + 1], part, 0);
        z[3 * k] += dot < 0 ? -x : x;
        z[3 * k + 1] += dot < 0 ? -y : y;
      }
      const int down = std::max(bit_width(size) - kDotBits, 0);
      energy += std::min(scaled(size >> down, part, down - 2 * energy_shift), kEnergyLimit);
    }
  }
  return energy;
}

}  // namespace ruffini
