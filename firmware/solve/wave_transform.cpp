#include "solve/wave_transform.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "base/processor.h"

// The loops are compiled twice, with AVX2 if the processor has it; integer results are bit-identical.
#define RUFFINI_INLINED inline __attribute__((always_inline))

namespace ruffini {
namespace {

constexpr int kBits = 14;

// Number of columns that stay in registers. If it does not divide the width, the last columns are computed twice.
constexpr size_t kColumns = 16;

// Products of 16-bit numbers and 32-bit sums.
RUFFINI_INLINED void multiply_columns(const int16_t* left, size_t n_rows, size_t n_inner, const int16_t* right,
                                      size_t n_columns, int32_t* out) {
  for (size_t row = 0; row < n_rows; ++row, left += n_inner, out += n_columns) {
    for (size_t column = 0; column < n_columns; column += kColumns) {
      const size_t first = std::min(column, n_columns - kColumns);
      int32_t sum[kColumns] = {};
      for (size_t k = 0; k < n_inner; ++k) {
        const int16_t factor = left[k];
        const int16_t* line = right + k * n_columns + first;
        for (size_t c = 0; c < kColumns; ++c) sum[c] += factor * line[c];
      }
      std::copy_n(sum, kColumns, out + first);
    }
  }
}

RUFFINI_INLINED int narrow(std::span<const int32_t> values, std::span<int16_t> out) {
  uint32_t largest = 0;
  for (const int32_t v : values) largest = std::max(largest, static_cast<uint32_t>(v < 0 ? -v : v));
  const int shift = std::max(static_cast<int>(std::bit_width(largest + (largest >> (kBits - 1)))) - kBits, 0);
  if (shift == 0) {
    std::transform(values.begin(), values.end(), out.begin(), [](int32_t v) { return static_cast<int16_t>(v); });
    return 0;
  }
  // Rounds half up without an intermediate sum, which could overflow: |values| may be up to 2^31 - 1.
  for (size_t i = 0; i < values.size(); ++i) {
    out[i] = static_cast<int16_t>((values[i] >> shift) + ((values[i] >> (shift - 1)) & 1));
  }
  return shift;
}

struct Loops {
  void (*multiply)(const int16_t*, size_t, size_t, const int16_t*, size_t, int32_t*);
  int (*narrow)(std::span<const int32_t>, std::span<int16_t>);
};

void multiply_any(const int16_t* left, size_t n_rows, size_t n_inner, const int16_t* right, size_t n_columns,
                  int32_t* out) {
  multiply_columns(left, n_rows, n_inner, right, n_columns, out);
}

int narrow_any(std::span<const int32_t> values, std::span<int16_t> out) { return narrow(values, out); }

#if defined(__x86_64__)
#define RUFFINI_AVX2 __attribute__((target("avx2")))
RUFFINI_AVX2 void multiply_avx2(const int16_t* left, size_t n_rows, size_t n_inner, const int16_t* right,
                                size_t n_columns, int32_t* out) {
  multiply_columns(left, n_rows, n_inner, right, n_columns, out);
}

RUFFINI_AVX2 int narrow_avx2(std::span<const int32_t> values, std::span<int16_t> out) { return narrow(values, out); }

const Loops kLoops = has_avx2() ? Loops{multiply_avx2, narrow_avx2} : Loops{multiply_any, narrow_any};
#else
constexpr Loops kLoops = {multiply_any, narrow_any};
#endif

// out = left right, row by row; `right` and `out` are accessed along their rows.
void multiply(std::span<const int16_t> left, size_t n_rows, size_t n_inner, const int16_t* right, size_t n_columns,
              int32_t* out) {
  if (n_columns >= kColumns) return kLoops.multiply(left.data(), n_rows, n_inner, right, n_columns, out);
  for (size_t row = 0; row < n_rows; ++row, out += n_columns) {
    std::fill_n(out, n_columns, 0);
    for (size_t k = 0; k < n_inner; ++k) {
      for (size_t c = 0; c < n_columns; ++c) out[c] += left[row * n_inner + k] * right[k * n_columns + c];
    }
  }
}

size_t count(int n) { return static_cast<size_t>(n); }

}  // namespace

int narrow_to_14(std::span<const int32_t> values, std::span<int16_t> out) { return kLoops.narrow(values, out); }

WaveTable::WaveTable(std::span<const int16_t> entries, int n_waves_, int n_places_)
    : n_waves(n_waves_), n_places(n_places_), by_wave(entries.begin(), entries.end()), by_place(entries.size()) {
  for (size_t w = 0; w < count(n_waves); ++w) {
    for (size_t p = 0; p < count(n_places); ++p) by_place[p * count(n_waves) + w] = by_wave[w * count(n_places) + p];
  }
}

WaveTransform::WaveTransform(std::vector<Kind> kinds) : kinds_(std::move(kinds)) {
  const Kind& k = kinds_.front();
  const size_t along_x = std::max(count(k.x->n_waves), count(k.x->n_places));
  const size_t along_y = std::max(count(k.y->n_waves), count(k.y->n_places));
  narrow_.resize(kinds_.size() * along_x * along_y);
  wide_.resize(narrow_.size());
}

size_t WaveTransform::n_places() const { return count(kinds_.front().y->n_places) * count(kinds_.front().x->n_places); }

size_t WaveTransform::n_waves() const { return count(kinds_.front().y->n_waves) * count(kinds_.front().x->n_waves); }

int WaveTransform::to_waves(std::span<const int32_t> field, std::span<int16_t> waves) {
  const size_t size = n_places();
  int exponent = narrow_to_14(field, narrow_);
  const size_t half = count(kinds_.front().y->n_waves) * count(kinds_.front().x->n_places);
  for (size_t c = 0; c < kinds_.size(); ++c) {
    const auto& [y, x] = kinds_[c];
    multiply(y->by_wave, count(y->n_waves), count(y->n_places), &narrow_[c * size], count(x->n_places),
             &wide_[c * half]);
  }
  exponent += narrow_to_14(std::span(wide_).first(kinds_.size() * half), narrow_) - kFraction;
  for (size_t c = 0; c < kinds_.size(); ++c) {
    const auto& [y, x] = kinds_[c];
    multiply(std::span(narrow_).subspan(c * half, half), count(y->n_waves), count(x->n_places), x->by_place.data(),
             count(x->n_waves), &wide_[c * n_waves()]);
  }
  return exponent + narrow_to_14(std::span(wide_).first(kinds_.size() * n_waves()), waves) - kFraction;
}

int WaveTransform::to_places(std::span<const int16_t> waves, std::span<int32_t> field) {
  const size_t half = count(kinds_.front().y->n_waves) * count(kinds_.front().x->n_places);
  for (size_t c = 0; c < kinds_.size(); ++c) {
    const auto& [y, x] = kinds_[c];
    multiply(waves.subspan(c * n_waves(), n_waves()), count(y->n_waves), count(x->n_waves), x->by_wave.data(),
             count(x->n_places), &wide_[c * half]);
  }
  const int shift = narrow_to_14(std::span(wide_).first(kinds_.size() * half), narrow_);
  for (size_t c = 0; c < kinds_.size(); ++c) {
    const auto& [y, x] = kinds_[c];
    multiply(y->by_place, count(y->n_places), count(y->n_waves), &narrow_[c * half], count(x->n_places),
             &field[c * n_places()]);
  }
  return shift - 2 * kFraction;
}

}  // namespace ruffini
