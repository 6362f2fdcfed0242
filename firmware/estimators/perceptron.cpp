#include "estimators/perceptron.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kInputFraction = 14;
constexpr int kUnitFraction = 15;
constexpr int kTableShift = 6;  // from Q12 to steps of 1/64
constexpr int64_t kMaxShift = 40;

// Keeps the sum of a row within 63 bits: int32 weights, inputs up to 2^20, at most 64 of them and a bias.
static_assert((Perceptron::kMaxHidden + 1) * (int64_t{1} << 31) <= (int64_t{1} << 62) / Perceptron::kMaxInput);

int64_t row_of(std::span<const int32_t> weights, std::span<const int64_t> values, int one_fraction) {
  int64_t sum = int64_t{weights.back()} << one_fraction;
  for (size_t i = 0; i < values.size(); ++i) sum += weights[i] * values[i];
  return sum;
}

}  // namespace

Result<TanhTable> TanhTable::load(const Calibration& c, const std::string& name) {
  const auto tensor = c.tensor(name, Tensor::Type::kI16, {kSize});
  if (!tensor) return tensor.error();
  const auto values = tensor.value()->as<int16_t>();
  if (values.front() != 0 || !std::is_sorted(values.begin(), values.end())) {
    return Error{ErrorKind::kBadInput, "calibration file: " + name + " does not rise from 0: make it again"};
  }
  TanhTable out;
  out.table_.assign(values.begin(), values.end());
  return out;
}

int64_t TanhTable::tanh_q15(int64_t a_q12) const {
  const int64_t size = std::min<int64_t>(std::abs(a_q12), int64_t{kSize - 1} << kTableShift);
  const auto i = static_cast<size_t>(std::min<int64_t>(size >> kTableShift, kSize - 2));
  const int64_t part = size - (static_cast<int64_t>(i) << kTableShift);
  const int64_t whole = int64_t{1} << kTableShift;
  const int64_t value = round_shift(table_[i] * (whole - part) + table_[i + 1] * part, kTableShift);
  return a_q12 < 0 ? -value : value;
}

Result<Perceptron> Perceptron::load(const Calibration& c, const std::string& name, int n_inputs, int n_outputs) {
  const Tensor* hidden = c.tensor(name + "_hidden");
  if (hidden == nullptr || hidden->type != Tensor::Type::kI32 || hidden->shape.size() != 2 || hidden->shape[0] < 1 ||
      hidden->shape[0] > kMaxHidden || hidden->shape[1] != n_inputs + 1) {
    return Error{ErrorKind::kBadInput, "calibration file: " + name + "_hidden is no table of 1 to 64 units with " +
                                           std::to_string(n_inputs) + " inputs: make it again"};
  }
  const int64_t n_hidden = hidden->shape[0];
  const auto out = c.tensor(name + "_out", Tensor::Type::kI32, {n_outputs, n_hidden + 1});
  if (!out) return out.error();
  const auto shift = c.tensor(name + "_shift", Tensor::Type::kU8, {2});
  if (!shift) return shift.error();
  const auto shifts = shift.value()->as<uint8_t>();
  if (std::any_of(shifts.begin(), shifts.end(), [](uint8_t s) { return s < 1 || s > kMaxShift; })) {
    return Error{ErrorKind::kBadInput, "calibration file: " + name + "_shift is not within 1 to 40: make it again"};
  }
  Perceptron net;
  net.n_inputs_ = static_cast<size_t>(n_inputs);
  net.hidden_.assign(hidden->as<int32_t>().begin(), hidden->as<int32_t>().end());
  net.out_.assign(out.value()->as<int32_t>().begin(), out.value()->as<int32_t>().end());
  net.hidden_shift_ = shifts[0];
  net.out_shift_ = shifts[1];
  net.unit_.resize(static_cast<size_t>(n_hidden));
  return net;
}

void Perceptron::run(const TanhTable& tanh, std::span<const int64_t> inputs, std::span<int64_t> outputs,
                     SaturationCounter& saturations) {
  const std::span<const int32_t> hidden(hidden_);
  const std::span<const int32_t> out(out_);
  if (std::any_of(inputs.begin(), inputs.end(), [](int64_t x) { return std::abs(x) > kMaxInput; })) {
    ++saturations.count;
    std::fill(outputs.begin(), outputs.end(), 0);
    return;
  }
  for (size_t j = 0; j < unit_.size(); ++j) {
    const int64_t sum = row_of(hidden.subspan(j * (n_inputs_ + 1), n_inputs_ + 1), inputs, kInputFraction);
    unit_[j] = tanh.tanh_q15(round_shift(sum, hidden_shift_));
  }
  for (size_t k = 0; k < outputs.size(); ++k) {
    const int64_t sum = row_of(out.subspan(k * (unit_.size() + 1), unit_.size() + 1), unit_, kUnitFraction);
    outputs[k] = round_shift(sum, out_shift_);
  }
}

}  // namespace ruffini
