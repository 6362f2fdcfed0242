#include "stages/fingertip/tip_area.h"

#include <algorithm>
#include <numeric>
#include <string>

#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int64_t kFlat = 4'800;         // 0.3 mm: well above the noise of a tip's height
constexpr int64_t kHeightSigma = 1'120;  // 0.07 mm: tracking error of a moving pin
constexpr int64_t kTopUm2 = 6'000'000;
constexpr size_t kFirstRidge = 2, kFirstBend = 3, kLastKey = 18;  // rings
constexpr int64_t kWhole = 45'875;                                // 0.7, Q16
constexpr int64_t kMaxCount = 16;                                 // of an input's grid points
constexpr int64_t kMaxRadius = 1 << 20;                           // 65 mm
constexpr int64_t kMaxCell = 1 << 24;                             // um^2
constexpr int kFine = 12;                                         // fraction bits between grid points
using Vector = TipField::Vector;

}  // namespace

Result<std::optional<TipArea>> TipArea::load(const Calibration& c) {
  if (c.tensor("fingertip.ray") == nullptr) return std::optional<TipArea>();
  const auto bad = [](const char* what) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: " + std::string(what) + ": make it again with cal fit --only fingertip"};
  };
  const auto read = [&](const char* name, const std::vector<int64_t>& shape) {
    return c.tensor(name, Tensor::Type::kI32, shape);
  };
  const auto ray = read("fingertip.ray", {int64_t{kRays}, int64_t{kRings}, 3});
  const auto cell = read("fingertip.cell", {int64_t{kRings}});
  const auto tip = read("fingertip.tip", {1});
  const auto axis = read("fingertip.face_axis", {int64_t{kInputs}, 3});
  for (const auto* each : {&ray, &cell, &tip, &axis}) {
    if (!*each) return each->error();
  }
  TipArea out;
  const auto g = ray.value()->as<int32_t>(), a = axis.value()->as<int32_t>(), s = cell.value()->as<int32_t>();
  out.tip_ = tip.value()->as<int32_t>()[0];
  int64_t n = 1;
  for (size_t i = 0; i < kInputs; ++i) {
    Axis& own = out.axis_[i];
    own = {a[3 * i], a[3 * i + 1], a[3 * i + 2]};
    if (own.step < 1 || own.count < 2 || own.count > kMaxCount) return bad("fingertip.face_axis is out of range");
    n *= own.count;
  }
  const auto table = read("fingertip.face", {n, int64_t{kOutputs}});
  if (!table) return table.error();
  const auto is_within = [](int64_t limit) { return [limit](int32_t v) { return v >= -limit && v <= limit; }; };
  if (out.tip_ < 1 || out.tip_ > kMaxRadius || !std::all_of(g.begin(), g.end(), is_within(1 << 14)) ||
      !std::all_of(s.begin(), s.end(), [](int32_t v) { return v >= 1 && v <= kMaxCell; })) {
    return bad("fingertip.ray, .cell or .tip is out of range");
  }
  const auto values = table.value()->as<int32_t>();
  if (!std::all_of(values.begin(), values.end(), [](int32_t v) { return v >= 0 && v <= 1 << 24; })) {
    return bad("fingertip.face has a number out of range");
  }
  for (size_t i = 0; i < kRays * kRings; ++i) out.ray_.push_back({g[3 * i], g[3 * i + 1], g[3 * i + 2]});
  std::copy(s.begin(), s.end(), out.cell_.begin());
  out.table_.assign(values.begin(), values.end());
  out.height_.resize(kRays * kRings);
  out.order_.resize(kRays * kRings);
  return std::optional<TipArea>(std::move(out));
}

void TipArea::find_heights(const TipField& field, const Vector& axis_1e6) {
  const Vector t = TipField::rounded(field.turn() * axis_1e6);
  for (size_t i = 0; i < ray_.size(); ++i) {
    height_[i] = floor_div(t.dot(TipField::rounded(tip_ * ray_[i]) + field.at(ray_[i])), 1'000'000);
  }
}

// Mean height of the highest kTopUm2 of the wall, each place weighted by its cell.
int64_t TipArea::find_top() {
  std::iota(order_.begin(), order_.end(), size_t{0});
  std::sort(order_.begin(), order_.end(),
            [&](size_t a, size_t b) { return height_[a] != height_[b] ? height_[a] > height_[b] : a < b; });
  int64_t area = 0, sum = 0;
  for (const size_t i : order_) {
    if (area >= kTopUm2) break;
    area += cell_[i % kRings];
    sum += cell_[i % kRings] * height_[i];
  }
  return floor_div(sum, area);
}

int64_t TipArea::area_above(int64_t height) const {
  int64_t area = 0;
  for (size_t i = 0; i < height_.size(); ++i) area += height_[i] > height ? cell_[i % kRings] : 0;
  return area;
}

TipArea::Key TipArea::key_points() const {
  Key key;
  for (size_t k = 0; k < kRays; ++k) {
    const int64_t* h = height_.data() + k * kRings;
    size_t ridge = kFirstRidge, bend = kFirstBend;
    const auto bent = [&](size_t i) { return 2 * h[i] - h[i + 2] - h[i - 2]; };
    for (size_t i = kFirstRidge; i <= kLastKey; ++i) {
      if (h[i] > h[ridge]) ridge = i;
      if (i > kFirstBend && bent(i) > bent(bend)) bend = i;
    }
    key.ridge[k] = static_cast<int64_t>(ridge);
    key.bend[k] = static_cast<int64_t>(bend);
  }
  return key;
}

std::array<int64_t, TipArea::kOutputs> TipArea::look_up(const std::array<int64_t, kInputs>& at) const {
  constexpr size_t kCorners = size_t{1} << kInputs;
  std::array<int64_t, kInputs> low{}, part{};
  for (size_t i = 0; i < kInputs; ++i) {
    const Axis& a = axis_[i];
    const int64_t place = std::clamp<int64_t>(at[i] - a.zero, 0, a.step * (a.count - 1));
    low[i] = std::min(place / a.step, a.count - 2);
    part[i] = ((place - low[i] * a.step) << kFine) / a.step;
  }
  std::array<std::array<int64_t, kOutputs>, kCorners> corner{};
  for (size_t c = 0; c < kCorners; ++c) {
    int64_t index = 0;  // the first input varies slowest; bit i of c: the upper grid point of input i
    for (size_t i = 0; i < kInputs; ++i) index = index * axis_[i].count + low[i] + static_cast<int64_t>(c >> i & 1);
    for (size_t o = 0; o < kOutputs; ++o) corner[c][o] = table_[static_cast<size_t>(index) * kOutputs + o];
  }
  for (size_t i = kInputs; i-- > 0;) {
    const size_t half = size_t{1} << i;
    for (size_t c = 0; c < half; ++c) {
      for (size_t o = 0; o < kOutputs; ++o) {
        corner[c][o] += round_shift((corner[c + half][o] - corner[c][o]) * part[i], kFine);
      }
    }
  }
  return corner[0];
}

TipAreas TipArea::run(const TipField& field, const Vector& axis_1e6, int64_t force_un, int64_t travel_um) {
  find_heights(field, axis_1e6);
  const int64_t top = find_top();
  TipAreas out{.flat_area_um2 = area_above(top - kFlat)};
  const int64_t change = area_above(top - kFlat - kHeightSigma) - area_above(top - kFlat + kHeightSigma);
  out.flat_area_sigma_um2 = std::max<int64_t>(change / 2, cell_.back());
  const Key key = key_points();
  const auto radius_q8 = [](const std::array<int64_t, kRays>& ring) {
    int64_t sum = 0;
    for (size_t k = 0; k < kRays; ++k) sum += ring[k] * ring[(k + 1) % kRays];
    return floor_sqrt((sum << 16) / int64_t{kRays});
  };
  const auto [area_1e3, part_q16, whole_q16] =
      look_up({force_un, travel_um, radius_q8(key.bend), radius_q8(key.ridge)});
  if (whole_q16 < kWhole) return out;
  out.face_um2 = area_1e3 * 1'000;
  out.face_sigma_um2 = std::max<int64_t>(area_1e3 * part_q16 * 1'000 >> 16, 1);
  return out;
}

}  // namespace ruffini
