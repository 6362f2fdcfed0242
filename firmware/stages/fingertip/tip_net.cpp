#include "stages/fingertip/tip_net.h"

#include <algorithm>
#include <string>

namespace ruffini {
namespace {

constexpr int64_t kMaxFeature = 1 << 20;     // 65 mm
constexpr int64_t kMaxComponent = 1 << 22;   // 64
constexpr int64_t kMaxActivation = 1 << 24;  // 256
constexpr int32_t kMaxWeight = 1 << 26;
constexpr int32_t kMaxLength = 1 << 20;  // 65 mm, of `length` and `limit`
constexpr int kFirstShift = 12;          // Q28 to Q16
constexpr int64_t kMaxInputs = 2'048;
static_assert(TipNet::kMaxWidth * kMaxWeight * kMaxActivation < int64_t{1} << 61);
static_assert(kMaxInputs * kMaxWeight * kMaxFeature < int64_t{1} << 62);
static_assert(kMaxInputs * kMaxFeature * kMaxFeature < int64_t{1} << 62);
static_assert(TipNet::kMaxWidth * (kMaxComponent * kMaxLength >> 16) * (kMaxComponent * kMaxLength >> 16) < int64_t{1}
                                                                                                                << 62);
static_assert(kMaxInputs * kMaxLength * kMaxLength < int64_t{1} << 62);

int64_t held(int64_t value, int64_t limit, SaturationCounter& saturations) {
  if (value >= -limit && value <= limit) return value;
  ++saturations.count;
  return std::clamp(value, -limit, limit);
}

}  // namespace

Result<TipNet> TipNet::load(const Calibration& c, size_t mode, size_t n_modes, size_t n_features, size_t n_outputs) {
  TipNet net;
  const auto modes = static_cast<int64_t>(n_modes);
  const auto bad = [](const std::string& what) {
    return Error{ErrorKind::kBadInput, "calibration file: " + what + ": make it again with cal fit --only fingertip"};
  };
  const auto read = [&](const std::string& name, std::vector<int64_t> shape, std::vector<int32_t>& into,
                        int32_t limit = kMaxWeight) -> Status {
    shape.insert(shape.begin(), modes);
    const auto tensor = c.tensor("fingertip." + name, Tensor::Type::kI32, shape);
    if (!tensor) return tensor.error();
    const auto all = tensor.value()->as<int32_t>();
    const auto own = all.subspan(mode * all.size() / n_modes, all.size() / n_modes);
    if (!std::all_of(own.begin(), own.end(), [&](int32_t v) { return v >= -limit && v <= limit; })) {
      return bad("fingertip." + name + " has a number out of range");
    }
    into.assign(own.begin(), own.end());
    return Unit{};
  };
  std::array<int64_t, kLayers + 2> width{static_cast<int64_t>(n_features)};
  for (size_t i = 0; i <= kLayers; ++i) {
    const Tensor* const weight = c.tensor("fingertip.weight" + std::to_string(i));
    if (weight == nullptr || weight->shape.size() != 3 || weight->shape[1] < 1 || weight->shape[1] > kMaxWidth) {
      return bad("fingertip.weight" + std::to_string(i) + " is missing or too wide");
    }
    width[i + 1] = weight->shape[1];
    Layer& layer = i == 0 ? net.first_ : net.layer_[i - 1];
    layer.n_in = static_cast<size_t>(width[i]);
    if (Status done = read("weight" + std::to_string(i), {width[i + 1], width[i]}, layer.weight); !done) {
      return done.error();
    }
    if (i == 0) continue;
    if (Status done = read("bias" + std::to_string(i), {width[i + 1]}, layer.bias); !done) return done.error();
  }
  if (width.back() != static_cast<int64_t>(n_outputs) || width[0] > kMaxInputs) {
    return bad("fingertip.weight3 has another number of outputs");
  }
  std::vector<int32_t> limits;
  for (const Status& done :
       {read("mean", {width[0]}, net.mean_), read("near", {width[1]}, net.near_),
        read("length", {width[1]}, net.length_, kMaxLength), read("limit", {2}, limits, kMaxLength)}) {
    if (!done) return done.error();
  }
  net.limit_ = limits[0];
  net.rest_ = limits[1];
  const auto widest = static_cast<size_t>(*std::max_element(width.begin() + 1, width.end()));
  net.centred_.resize(n_features);
  net.z_.resize(static_cast<size_t>(width[1]));
  net.in_.resize(widest);
  net.out_.resize(widest);
  return net;
}

void TipNet::judge(int64_t square) {
  int64_t far = 0;
  int64_t left = square;
  for (size_t i = 0; i < z_.size(); ++i) {
    const int64_t z_q8 = z_[i] >> 8;
    far += round_shift(z_q8 * z_q8 * near_[i], 12);
    const int64_t along = round_shift(z_[i] * length_[i], 16);
    left -= along * along;
  }
  is_known_ = far <= limit_ << 16 && left <= rest_ * rest_ * static_cast<int64_t>(centred_.size());
}

std::span<const int64_t> TipNet::run(std::span<const int32_t> features, SaturationCounter& saturations) {
  int64_t square = 0;
  for (size_t i = 0; i < centred_.size(); ++i) {
    centred_[i] = held(int64_t{features[i]} - mean_[i], kMaxFeature, saturations);
    square += centred_[i] * centred_[i];
  }
  for (size_t row = 0; row < z_.size(); ++row) {
    int64_t sum = 0;
    for (size_t i = 0; i < centred_.size(); ++i) sum += first_.weight[row * first_.n_in + i] * centred_[i];
    z_[row] = held(round_shift(sum, kFirstShift), kMaxComponent, saturations);
  }
  judge(square);
  std::copy(z_.begin(), z_.end(), in_.begin());
  for (size_t i = 0; i < kLayers; ++i) {
    const Layer& layer = layer_[i];
    for (size_t row = 0; row < layer.bias.size(); ++row) {
      int64_t sum = int64_t{layer.bias[row]} << 16;
      for (size_t k = 0; k < layer.n_in; ++k) sum += layer.weight[row * layer.n_in + k] * in_[k];
      const int64_t value = held(round_shift(sum, 16), kMaxActivation, saturations);
      out_[row] = i + 1 < kLayers ? std::max<int64_t>(value, 0) : value;
    }
    std::swap(in_, out_);
  }
  return {in_.data(), layer_.back().bias.size()};
}

}  // namespace ruffini
