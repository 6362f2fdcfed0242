#include "solve/finite_strain.h"

#include <algorithm>
#include <bit>
#include <string>
#include <tuple>
#include <utility>

#include "solve/block_float.h"

namespace ruffini {
namespace {

using block_float::clamp_counted;
using block_float::shift_saturating;

constexpr int kAmplitudeBits = 13;
constexpr int kPlaneFraction = 4;
constexpr int64_t kPlaneLimit = int64_t{1} << 22;
constexpr int kPressureFraction = 12;
constexpr int64_t kPressureLimit = 32767;
constexpr int kSlopeFraction = 15;
constexpr int64_t kGradientLimit = int64_t{1} << 14;
constexpr int kSumFraction = 12;
constexpr int64_t kSumLimit = int64_t{1} << 58;
constexpr int64_t kMaxFactor = 1023;  // of an area or a volume
constexpr int64_t kMaxLayers = 8;
constexpr int kMaxShift = 60;

Error bad(const std::string& what) {
  return Error{ErrorKind::kBadInput, "calibration file: finite_strain." + what + ": make it again"};
}

size_t count(int n) { return static_cast<size_t>(n); }

Result<WaveTable> load_waves(const Calibration& c, const std::string& name, int n_waves, int n_places) {
  auto table = c.tensor("finite_strain." + name, Tensor::Type::kI16, {n_waves, n_places});
  if (!table) return table.error();
  const auto entries = table.value()->as<int16_t>();
  constexpr int kLargest = 1 << WaveTransform::kFraction;
  if (std::any_of(entries.begin(), entries.end(), [](int v) { return v < -kLargest || v > kLargest; })) {
    return bad(name + " has a wave above one");
  }
  return WaveTable(entries, n_waves, n_places);
}

// True if all values are within 1 to `largest`.
Status fill(const Calibration& c, const std::string& name, const std::vector<int64_t>& shape, int64_t largest,
            std::span<const int32_t>& out) {
  auto table = c.tensor("finite_strain." + name, Tensor::Type::kI32, shape);
  if (!table) return table.error();
  out = table.value()->as<int32_t>();
  if (std::any_of(out.begin(), out.end(), [&](int32_t v) { return v < 1 || v > largest; })) {
    return bad(name + " is not within 1 to " + std::to_string(largest));
  }
  return Unit{};
}

}  // namespace

FiniteStrain::FiniteStrain(GridSize nodes, std::unique_ptr<const Waves> waves)
    : nodes_(nodes),
      tables_(std::move(waves)),
      at_nodes_(
          {{&tables_->cos_y, &tables_->sin_x}, {&tables_->sin_y, &tables_->cos_x}, {&tables_->cos_y, &tables_->cos_x}}),
      at_middles_(std::vector<WaveTransform::Kind>{{&tables_->mid_y, &tables_->mid_x}}) {}

Result<FiniteStrain> FiniteStrain::load(const Calibration& c, GridSize nodes) {
  auto waves_x = c.integer("finite_strain.waves_x", 1, WaveTransform::kMaxTerms);
  if (!waves_x) return waves_x.error();
  auto waves_y = c.integer("finite_strain.waves_y", 1, WaveTransform::kMaxTerms);
  if (!waves_y) return waves_y.error();
  if (std::min(nodes.n_x, nodes.n_y) < 2 || std::max(nodes.n_x, nodes.n_y) > WaveTransform::kMaxTerms) {
    return bad("needs 2 to " + std::to_string(WaveTransform::kMaxTerms) + " nodes a side");
  }
  const auto m_x = static_cast<int>(waves_x.value());
  const auto m_y = static_cast<int>(waves_y.value());
  std::vector<WaveTable> tables;
  for (const auto& [name, n_waves, n_places] : {std::tuple{"cos_x", m_x, nodes.n_x},
                                                {"sin_x", m_x, nodes.n_x},
                                                {"mid_x", m_x, nodes.n_x - 1},
                                                {"cos_y", m_y, nodes.n_y},
                                                {"sin_y", m_y, nodes.n_y},
                                                {"mid_y", m_y, nodes.n_y - 1}}) {
    auto table = load_waves(c, name, n_waves, n_places);
    if (!table) return table.error();
    tables.push_back(std::move(table).value());
  }
  FiniteStrain out(
      nodes, std::make_unique<const Waves>(Waves{tables[0], tables[1], tables[2], tables[3], tables[4], tables[5]}));
  if (const Status loaded = out.load_layers(c); !loaded) return loaded.error();
  const size_t n_waves = count(m_x * m_y);
  const size_t n_nodes = count(nodes.count());
  const size_t n_middles = count((nodes.n_x - 1) * (nodes.n_y - 1));
  out.wave_.resize(3 * n_waves);
  out.part_.resize(3 * n_waves);
  out.sums_.resize(3 * n_waves);
  out.total_.resize(3 * n_waves);
  out.field_.resize(3 * n_nodes);
  out.planes_.resize(3 * n_nodes * (out.layers_.size() + 1));
  out.load_.resize(out.planes_.size());
  out.pressure_.resize(n_middles);
  out.square_.resize(n_middles);
  out.force_.resize(n_nodes);
  return out;
}

Status FiniteStrain::load_layers(const Calibration& c) {
  const std::pair<const char*, int*> shifts[] = {{"finite_strain.extension_shift", &extension_shift_},
                                                 {"finite_strain.pressure_shift", &pressure_shift_},
                                                 {"finite_strain.volume_shift", &volume_shift_},
                                                 {"finite_strain.gain_shift", &gain_shift_}};
  for (const auto& [key, out] : shifts) {
    auto value = c.integer(key, 0, kMaxShift);
    if (!value) return value.error();
    *out = static_cast<int>(value.value());
  }
  auto gain = c.integer("finite_strain.gain", 1, 32767);
  if (!gain) return gain.error();
  gain_ = gain.value();
  auto n_layers = c.integer("finite_strain.layers", 1, kMaxLayers);
  if (!n_layers) return n_layers.error();
  const int64_t n = n_layers.value();
  const int64_t m_x = tables_->cos_x.n_waves;
  const int64_t m_y = tables_->cos_y.n_waves;
  auto extension = c.tensor("finite_strain.extension", Tensor::Type::kI16, {n, 3, 3, m_y, m_x});
  if (!extension) return extension.error();
  auto pressure = c.tensor("finite_strain.pressure", Tensor::Type::kI16, {n, 3, m_y, m_x});
  if (!pressure) return pressure.error();
  std::span<const int32_t> slope, area, volume;
  if (const Status s = fill(c, "slope", {n, 3}, int64_t{1} << 20, slope); !s) return s.error();
  if (const Status s = fill(c, "area", {n, 3}, kMaxFactor, area); !s) return s.error();
  if (const Status s = fill(c, "volume", {n}, kMaxFactor, volume); !s) return s.error();
  const auto n_waves = static_cast<size_t>(m_x * m_y);
  for (size_t k = 0; k < static_cast<size_t>(n); ++k) {
    Layer layer;
    for (size_t j = 0; j < 3; ++j) {
      layer.slope[j] = slope[3 * k + j];
      layer.limit[j] = static_cast<int32_t>((kGradientLimit << kSlopeFraction) / slope[3 * k + j]);
      layer.area[j] = area[3 * k + j];
    }
    layer.volume = volume[k];
    layer.extension = extension.value()->as<int16_t>().subspan(9 * n_waves * k, 9 * n_waves);
    layer.pressure = pressure.value()->as<int16_t>().subspan(3 * n_waves * k, 3 * n_waves);
    layers_.push_back(layer);
  }
  return Unit{};
}

std::span<const NodeForce> FiniteStrain::run(std::span<const int16_t> u, SaturationCounter& saturations) {
  uint32_t largest = 0;
  for (const int32_t v : u) largest = std::max(largest, static_cast<uint32_t>(v < 0 ? -v : v));
  if (largest == 0) {
    std::fill(force_.begin(), force_.end(), NodeForce{});
    return force_;
  }
  const int amplitude = std::max(kAmplitudeBits - static_cast<int>(std::bit_width(largest)), 0);
  const size_t n_nodes = force_.size();
  for (size_t i = 0; i < n_nodes; ++i) {
    for (size_t c = 0; c < 3; ++c) field_[c * n_nodes + i] = u[3 * i + c] * (1 << amplitude);
  }
  const int exponent = at_nodes_.to_waves(field_, wave_);
  find_planes(exponent, saturations);
  std::fill(load_.begin(), load_.end(), 0);
  std::fill(total_.begin(), total_.end(), int64_t{0});
  for (size_t k = 0; k < layers_.size(); ++k) {
    find_pressure(layers_[k], exponent, saturations);
    deform(k, saturations);
    gather_volume(layers_[k], saturations);
  }
  gather_planes(saturations);
  finish(amplitude, saturations);
  return force_;
}

void FiniteStrain::find_planes(int exponent, SaturationCounter& saturations) {
  const size_t n = wave_.size() / 3;
  for (size_t k = 0; k < layers_.size(); ++k) {
    const int16_t* e = layers_[k].extension.data();
    for (size_t c = 0; c < 3; ++c) {
      for (size_t i = 0; i < n; ++i) {
        sums_[c * n + i] = e[3 * c * n + i] * wave_[i] + e[(3 * c + 1) * n + i] * wave_[n + i] +
                           e[(3 * c + 2) * n + i] * wave_[2 * n + i];
      }
    }
    const int shift = narrow_to_14(sums_, part_) + exponent - extension_shift_;
    const int right = -(shift + at_nodes_.to_places(part_, field_) + kPlaneFraction);
    for (size_t i = 0; i < field_.size(); ++i) {
      planes_[k * field_.size() + i] =
          static_cast<int32_t>(clamp_counted(shift_saturating(field_[i], right), saturations, kPlaneLimit));
    }
  }
}

void FiniteStrain::find_pressure(const Layer& layer, int exponent, SaturationCounter& saturations) {
  const size_t n = wave_.size() / 3;
  const int16_t* p = layer.pressure.data();
  const std::span<int32_t> sums = std::span(sums_).first(n);
  for (size_t i = 0; i < n; ++i) sums[i] = p[i] * wave_[i] + p[n + i] * wave_[n + i] + p[2 * n + i] * wave_[2 * n + i];
  const int shift = narrow_to_14(sums, part_) + exponent - pressure_shift_;
  const int right = -(shift + at_middles_.to_places(part_, pressure_) + kPressureFraction);
  for (int32_t& v : pressure_)
    v = static_cast<int32_t>(clamp_counted(shift_saturating(v, right), saturations, kPressureLimit));
}

// One element layer: computes H, the stress (p H^T - (H^T)^2) at its corners, and tr H^2 times its volume.
void FiniteStrain::deform(size_t k, SaturationCounter& saturations) {
  const Layer& layer = layers_[k];
  const size_t n_x = count(nodes_.n_x);
  const size_t n_nodes = count(nodes_.count());
  size_t middle = 0;
  for (size_t y = 0; y + 1 < count(nodes_.n_y); ++y) {
    for (size_t x = 0; x + 1 < n_x; ++x, ++middle) {
      int32_t h[3][3];  // [component][direction]
      for (size_t c = 0; c < 3; ++c) {
        const int32_t* u = &planes_[(3 * k + c) * n_nodes + y * n_x + x];
        const int32_t* l = u + 3 * n_nodes;
        const int32_t left = u[0] + l[0], right = u[1] + l[1], left_low = u[n_x] + l[n_x],
                      right_low = u[n_x + 1] + l[n_x + 1];
        const int32_t top = u[0] + u[1] + u[n_x] + u[n_x + 1];
        const int32_t all = left + right + left_low + right_low;
        const int32_t difference[3] = {right + right_low - left - left_low, left_low + right_low - left - right,
                                       2 * top - all};
        for (size_t j = 0; j < 3; ++j) {
          const auto d = static_cast<int32_t>(clamp_counted(difference[j], saturations, layer.limit[j]));
          h[c][j] = (d * layer.slope[j] + (1 << (kSlopeFraction - 1))) >> kSlopeFraction;
        }
      }
      const int32_t p = 2 * pressure_[middle];
      int32_t trace = 0;
      for (size_t i = 0; i < 3; ++i) {
        int32_t part[3];
        for (size_t j = 0; j < 3; ++j) {
          const int32_t square = h[0][i] * h[j][0] + h[1][i] * h[j][1] + h[2][i] * h[j][2];
          if (i == j) trace += square >> 2;
          const int32_t stress = (p * h[j][i] - square + (1 << 10)) >> 11;
          part[j] = (stress * layer.area[j] + (1 << 4)) >> 5;
        }
        int32_t* upper = &load_[(3 * k + i) * n_nodes + y * n_x + x];
        int32_t* lower = upper + 3 * n_nodes;
        const int32_t xy = part[0] + part[1], yx = part[0] - part[1];
        upper[0] += part[2] - xy;
        upper[1] += part[2] + yx;
        upper[n_x] += part[2] - yx;
        upper[n_x + 1] += part[2] + xy;
        lower[0] -= part[2] + xy;
        lower[1] += yx - part[2];
        lower[n_x] -= yx + part[2];
        lower[n_x + 1] += xy - part[2];
      }
      square_[middle] = ((trace + (1 << 10)) >> 11) * layer.volume;
    }
  }
}

void FiniteStrain::gather_volume(const Layer& layer, SaturationCounter& saturations) {
  const size_t n = wave_.size() / 3;
  const int e = at_middles_.to_waves(square_, part_) + volume_shift_ + extension_shift_ - pressure_shift_;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < n; ++i) {
      const int64_t work = layer.pressure[c * n + i] * part_[i];
      total_[c * n + i] += clamp_counted(shift_saturating(work, -(e + kSumFraction)), saturations, kSumLimit);
    }
  }
}

void FiniteStrain::gather_planes(SaturationCounter& saturations) {
  const size_t n = wave_.size() / 3;
  for (size_t k = 0; k < layers_.size(); ++k) {
    const int e = at_nodes_.to_waves(std::span(load_).subspan(k * field_.size(), field_.size()), part_);
    const int16_t* table = layers_[k].extension.data();
    for (size_t c = 0; c < 3; ++c) {
      for (size_t i = 0; i < n; ++i) {
        const int32_t work = table[c * n + i] * part_[i] + table[(3 + c) * n + i] * part_[n + i] +
                             table[(6 + c) * n + i] * part_[2 * n + i];
        total_[c * n + i] += clamp_counted(shift_saturating(work, -(e + kSumFraction)), saturations, kSumLimit);
      }
    }
  }
}

void FiniteStrain::finish(int amplitude, SaturationCounter& saturations) {
  int64_t largest = 0;
  for (const int64_t v : total_) largest = std::max(largest, v < 0 ? -v : v);
  const int shift = std::max(block_float::bit_width(largest + (largest >> 13)) - 14, 0);
  std::transform(total_.begin(), total_.end(), part_.begin(),
                 [&](int64_t v) { return static_cast<int16_t>(block_float::to_16(v, shift)); });
  const int e = at_nodes_.to_places(part_, field_) + shift - kSumFraction - extension_shift_ - 2 * amplitude;
  const size_t n_nodes = force_.size();
  const auto steps = [&](size_t at) {
    return saturate_raw<int32_t>(shift_saturating(field_[at] * gain_, gain_shift_ - e), saturations);
  };
  for (size_t i = 0; i < n_nodes; ++i) force_[i] = {steps(i), steps(n_nodes + i), steps(2 * n_nodes + i)};
}

}  // namespace ruffini
