#include "stages/skin/taxel_tables.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <utility>

#include "base/fixed.h"
#include "image/taxels.h"

namespace ruffini {
namespace {

constexpr int32_t kMaxPlaceUm = 1'000'000;
constexpr int32_t kMinGainQ16 = 1 << 14;
constexpr int32_t kMaxGainQ16 = 1 << 18;
constexpr int64_t kMaxKinds = 64;
constexpr int32_t kMaxSinkQ12 = 1 << 16;
constexpr int32_t kMaxPress = 1 << 24;
// Of Sigma's members, in their order.
constexpr std::array<int64_t, 4> kMinSigma = {1, 0, 1, 0};
constexpr std::array<int64_t, 4> kMaxSigma = {100'000'000, 4096, 1'000'000, 1'000'000};

Error bad(const std::string& what) {
  return {ErrorKind::kBadInput,
          "calibration file: skin." + what + ": make it again with `ruffini cal fit --only skin`"};
}

template <typename T>
bool is_within(std::span<const T> values, int64_t low, int64_t high) {
  return std::all_of(values.begin(), values.end(), [&](T v) { return v >= low && v <= high; });
}

// `any`: standard deviations of touches on taxels of any kind.
Status load_numbers(const Calibration& c, TaxelTables& t, TaxelTables::Sigma& any) {
  const struct {
    const char* key;
    int64_t low;
    int64_t high;
    int64_t* value;
  } numbers[] = {{"skin.reach_step_um", 100, 100'000, &t.reach_step_um},
                 {"skin.taxel_area_um2", 1, 1'000'000'000, &t.taxel_area_um2},
                 {"skin.floor_q12", 1, kMaxSinkQ12, &t.floor_q12},
                 {"skin.apart_q12", 1, 4096, &t.apart_q12},
                 {"skin.pair_q12", 0, 1 << 20, &t.pair_q12},
                 {"skin.sigma_un", kMinSigma[0], kMaxSigma[0], &any.force_un},
                 {"skin.sigma_q12", kMinSigma[1], kMaxSigma[1], &any.force_q12},
                 {"skin.place_sigma_um", kMinSigma[2], kMaxSigma[2], &any.place_um},
                 {"skin.faint_place_sigma_um", kMinSigma[3], kMaxSigma[3], &any.faint_place_um},
                 {"skin.stray_limit_q6", 1, 1 << 16, &t.stray_limit_q6}};
  for (const auto& number : numbers) {
    const auto value = c.integer(number.key, number.low, number.high);
    if (!value) return value.error();
    *number.value = value.value();
  }
  return Unit{};
}

Status load_curves(const Calibration& c, TaxelTables& t) {
  const auto sink = c.tensor("skin.sink", Tensor::Type::kI32, {TaxelTables::kSize});
  if (!sink) return sink.error();
  const auto press = c.tensor("skin.press", Tensor::Type::kI32, {TaxelTables::kSize});
  if (!press) return press.error();
  const auto sinks = sink.value()->as<int32_t>();
  const auto presses = press.value()->as<int32_t>();
  if (!is_within(sinks, -kMaxSinkQ12, kMaxSinkQ12)) return bad("sink is beyond 16");
  if (!is_within(presses, -kMaxPress, kMaxPress)) return bad("press is beyond 2^24 force steps");
  t.sink_q12.assign(sinks.begin(), sinks.end());
  t.press_lsb.assign(presses.begin(), presses.end());
  const Tensor* reach = c.tensor("skin.reach");
  if (reach == nullptr || reach->type != Tensor::Type::kI16 || reach->shape.size() != 2 || reach->shape[0] < 2 ||
      reach->shape[1] < 2 || reach->shape[0] > 256 || reach->shape[1] > 256) {
    return bad("reach is no table of 2 to 256 lines each way");
  }
  const auto values = reach->as<int16_t>();
  if (!is_within(values, 0, 1 << 14) || values[0] != 1 << 14) return bad("reach does not fall from 1");
  t.reach.assign(values.begin(), values.end());
  t.reach_size = {static_cast<int>(reach->shape[1]), static_cast<int>(reach->shape[0])};
  return Unit{};
}

// Number of kinds of taxels.
Result<int64_t> load_gain(const Calibration& c, TaxelTables& t) {
  const Tensor* const gain = c.tensor("skin.gain");
  constexpr int64_t kLeans = TaxelTables::kLeans;
  if (gain == nullptr || gain->type != Tensor::Type::kI32 || gain->shape.size() != 4 || gain->shape[0] < 1 ||
      gain->shape[0] > kMaxKinds || gain->shape[1] != int64_t{TaxelTables::kLoadsUn.size()} ||
      gain->shape[2] != kLeans || gain->shape[3] != kLeans) {
    return bad("gain is no table of 1 to 64 kinds, 6 loads and 9 by 9 leans");
  }
  const auto values = gain->as<int32_t>();
  if (!is_within(values, kMinGainQ16, kMaxGainQ16)) return bad("gain is not within 1/4 to 4");
  t.gain_q16.assign(values.begin(), values.end());
  return int64_t{gain->shape[0]};
}

// Of each kind, if the file tells them apart: those fitted before it did have one for all.
Status load_sigma(const Calibration& c, const TaxelTables::Sigma& any, int64_t n_kinds, TaxelTables& t) {
  t.sigma.assign(static_cast<size_t>(n_kinds), any);
  if (c.tensor("skin.sigma") == nullptr) return Unit{};
  const auto sigma = c.tensor("skin.sigma", Tensor::Type::kI32, {n_kinds, int64_t{kMinSigma.size()}});
  if (!sigma) return sigma.error();
  const auto values = sigma.value()->as<int32_t>();
  for (size_t i = 0; i < values.size(); ++i) {
    const size_t column = i % kMinSigma.size();
    if (values[i] < kMinSigma[column] || values[i] > kMaxSigma[column]) {
      return bad("sigma is not within 1 uN to 100 N, 0 to 1, 1 um to 1 m, 0 to 1 m");
    }
  }
  for (size_t kind = 0; kind < t.sigma.size(); ++kind) {
    const auto row = values.subspan(kind * kMinSigma.size(), kMinSigma.size());
    t.sigma[kind] = {.force_un = row[0], .force_q12 = row[1], .place_um = row[2], .faint_place_um = row[3]};
  }
  return Unit{};
}

}  // namespace

Result<TaxelTables> TaxelTables::load(const Calibration& c, const BoardSettings& board) {
  TaxelTables t;
  const auto n_taxels = c.integer("skin.taxels", 1, Taxels::kMaxTaxels);
  if (!n_taxels) return n_taxels.error();
  const int64_t n = n_taxels.value();
  Sigma any;
  const Status numbers = load_numbers(c, t, any);
  if (!numbers) return numbers.error();
  const Status curves = load_curves(c, t);
  if (!curves) return curves.error();
  const auto place = c.tensor("skin.taxel_place", Tensor::Type::kI32, {n, 2});
  if (!place) return place.error();
  const auto kind = c.tensor("skin.taxel_kind", Tensor::Type::kI16, {n});
  if (!kind) return kind.error();
  const auto n_kinds = load_gain(c, t);
  if (!n_kinds) return n_kinds.error();
  const Status sigma = load_sigma(c, any, n_kinds.value(), t);
  if (!sigma) return sigma.error();
  const auto near = c.tensor("skin.taxel_near", Tensor::Type::kI16, {n, kNeighbours});
  if (!near) return near.error();
  const auto shift = c.tensor("skin.taxel_shift", Tensor::Type::kI32, {n, 2, kCoefficients});
  if (!shift) return shift.error();
  const auto places = place.value()->as<int32_t>();
  const auto kinds = kind.value()->as<int16_t>();
  const auto nears = near.value()->as<int16_t>();
  const auto shifts = shift.value()->as<int32_t>();
  if (!is_within(places, -kMaxPlaceUm, kMaxPlaceUm)) return bad("taxel_place leads beyond 1 m of skin");
  if (!is_within(kinds, 0, n_kinds.value() - 1)) return bad("taxel_kind names no kind of skin.gain");
  if (!is_within(nears, -1, n - 1)) return bad("taxel_near names no taxel");
  if (!is_within(shifts, -256 * kMaxPlaceUm, 256 * kMaxPlaceUm)) return bad("taxel_shift leads beyond 1 m of skin");
  t.taxels.resize(static_cast<size_t>(n));
  for (size_t i = 0; i < t.taxels.size(); ++i) {
    Taxel& taxel = t.taxels[i];
    taxel.x_um = places[2 * i];
    taxel.y_um = places[2 * i + 1];
    taxel.kind = static_cast<size_t>(kinds[i]);
    std::copy_n(nears.begin() + static_cast<ptrdiff_t>(kNeighbours * i), kNeighbours, taxel.near.begin());
    for (size_t axis = 0; axis < 2; ++axis) {
      const auto from = shifts.begin() + static_cast<ptrdiff_t>(kCoefficients * (2 * i + axis));
      std::copy_n(from, kCoefficients, taxel.shift[axis].begin());
    }
  }
  t.round_um = board.skin.shape == SkinShape::kTube ? board.pad.size_x_um : 0;
  return t;
}

int64_t TaxelTables::wrapped_um(int64_t dx_um) const {
  dx_um = std::abs(dx_um);
  return round_um > 0 ? std::min(dx_um, std::abs(round_um - dx_um)) : dx_um;
}

int64_t TaxelTables::reach_q14(int64_t dx_um, int64_t dy_um) const {
  dx_um = wrapped_um(dx_um);
  dy_um = std::abs(dy_um);
  const int64_t column = dx_um / reach_step_um;
  const int64_t row = dy_um / reach_step_um;
  if (column > reach_size.n_x - 2 || row > reach_size.n_y - 2) return 0;
  const int64_t right = dx_um - column * reach_step_um;
  const int64_t below = dy_um - row * reach_step_um;
  const int16_t* const at = reach.data() + row * reach_size.n_x + column;
  const int64_t top = at[0] * (reach_step_um - right) + at[1] * right;
  const int64_t bottom = at[reach_size.n_x] * (reach_step_um - right) + at[reach_size.n_x + 1] * right;
  return (top * (reach_step_um - below) + bottom * below) / (reach_step_um * reach_step_um);
}

int64_t TaxelTables::gain_of(size_t kind, int64_t elastic_un, const std::array<int64_t, 2>& lean_q12) const {
  const int64_t load_un = std::clamp(elastic_un, kLoadsUn.front(), kLoadsUn.back());
  size_t load = 0;
  while (load + 2 < kLoadsUn.size() && load_un >= kLoadsUn[load + 1]) ++load;
  const int64_t beyond_q12 = floor_div((load_un - kLoadsUn[load]) * 4096, kLoadsUn[load + 1] - kLoadsUn[load]);
  std::array<size_t, 2> line{};
  std::array<int64_t, 2> part{};  // Q12
  for (size_t axis = 0; axis < 2; ++axis) {
    const int64_t at = lean_q12[axis] * int64_t{kLeans - 1};
    line[axis] = std::min<size_t>(static_cast<size_t>(at >> 12), kLeans - 2);
    part[axis] = at - static_cast<int64_t>(line[axis] << 12);
  }
  std::array<int64_t, 2> gain{};
  for (size_t i = 0; i < 2; ++i) {
    const int32_t* const row =
        gain_q16.data() + ((kind * kLoadsUn.size() + load + i) * kLeans + line[1]) * kLeans + line[0];
    const int64_t here = row[0] * (4096 - part[0]) + row[1] * part[0];
    const int64_t behind = row[kLeans] * (4096 - part[0]) + row[kLeans + 1] * part[0];
    gain[i] = round_shift(here * (4096 - part[1]) + behind * part[1], 24);
  }
  return round_shift(gain[0] * (4096 - beyond_q12) + gain[1] * beyond_q12, 12);
}

}  // namespace ruffini
