// Cosine transforms of length n, processing as many rows at once as there are lanes.
//
//   forward   X_k = sum_i x_i cos(pi k (2 i + 1) / (2 n))          (type II)
//   inverse   x_i = sum_k X_k cos(pi k (2 i + 1) / (2 n))          (type III; scaling is the caller's)
//
// An even n is split: sums and differences of mirrored positions give II(n) = II(n/2) and IV(n/2), interleaved; III(n)
// likewise. A type IV of even length m is m/2 rotations by pi (2 i + 1) / (4 m), two II(m/2) and m/2 - 1 sums and
// differences. Odd lengths, the leaves, are plain sums of products. Coefficients are Q30; each rotation and each leaf
// rounds once, half up.
//
// Bound: every intermediate value is a sum of inputs with coefficients within +-1, each input at most once. So n
// max|input| + n <= 2^30 keeps all values within 31 bits and all sums of products within 62.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace ruffini {

class CosineTables {
 public:
  explicit CosineTables(int n);

  struct Rotation {  // u = c a + s b; w = +-(c b - s a), negative at odd positions
    int32_t c = 0;
    int32_t s = 0;
    int32_t w_a = 0;
    int32_t w_b = 0;
  };

  [[nodiscard]] int length(size_t level) const { return n_ >> level; }
  [[nodiscard]] int leaf_length() const { return leaf_n_; }
  [[nodiscard]] bool is_leaf(size_t level) const { return level == rotation_.size(); }
  // Rotations of the type IV of length n >> level, which is even.
  [[nodiscard]] const Rotation* rotation(size_t level) const { return rotation_[level].data(); }
  // Row k of the leaf's type II and type IV.
  [[nodiscard]] const int32_t* leaf_ii(int k) const { return &leaf_ii_[static_cast<size_t>(k * leaf_n_)]; }
  [[nodiscard]] const int32_t* leaf_iv(int k) const { return &leaf_iv_[static_cast<size_t>(k * leaf_n_)]; }
  // Column i of the type II, which is row i of the type III.
  [[nodiscard]] const int32_t* leaf_iii(int i) const { return &leaf_iii_[static_cast<size_t>(i * leaf_n_)]; }

 private:
  int n_;
  int leaf_n_;
  std::vector<std::vector<Rotation>> rotation_;  // for each level that is not the leaf
  std::vector<int32_t> leaf_ii_;
  std::vector<int32_t> leaf_iii_;
  std::vector<int32_t> leaf_iv_;
};

template <typename L>
class CosineTransform {
 public:
  using V = typename L::V;

  // `work`: 3 n vectors for each of the two transforms below. In, out and work must not overlap.
  explicit CosineTransform(const CosineTables& tables) : tables_(tables) {}

  void forward(const V* in, V* out, V* work) const { type_ii(0, in, out, 1, work); }
  void inverse(const V* in, V* out, V* work) const { type_iii(0, in, 1, out, work); }

 private:
  static constexpr int kFraction = 30;

  // Computes the outputs, `stride` apart, from inputs `in_stride` apart. row(k): the k-th row of coefficients.
  template <typename Row>
  void leaf(const V* in, int in_stride, V* out, int stride, Row row) const {
    switch (tables_.leaf_length()) {  // common lengths are unrolled
      case 3:
        return sums_of_products<3>(in, in_stride, out, stride, row);
      case 5:
        return sums_of_products<5>(in, in_stride, out, stride, row);
      default:
        return sums_of_products<0>(in, in_stride, out, stride, row);
    }
  }
  template <int kLength, typename Row>
  void sums_of_products(const V* in, int in_stride, V* out, int stride, Row row) const {
    const int n = kLength > 0 ? kLength : tables_.leaf_length();
    for (int k = 0; k < n; ++k) {
      const int32_t* c = row(k);
      auto sum = L::scale(in[0], c[0]);
      for (int i = 1; i < n; ++i) sum = L::add_scaled(sum, in[i * in_stride], c[i]);
      out[k * stride] = L::template narrow<kFraction>(sum);
    }
  }

  void type_ii(size_t level, const V* in, V* out, int stride, V* work) const {
    if (tables_.is_leaf(level)) {
      return leaf(in, 1, out, stride, [&](int k) { return tables_.leaf_ii(k); });
    }
    const int n = tables_.length(level);
    const int half = n / 2;
    for (int i = 0; i < half; ++i) {
      work[i] = L::add(in[i], in[n - 1 - i]);
      work[half + i] = L::sub(in[i], in[n - 1 - i]);
    }
    type_ii(level + 1, work, out, 2 * stride, work + n);
    type_iv(level + 1, work + half, 1, out + stride, 2 * stride, work + n);
  }

  void type_iii(size_t level, const V* in, int stride, V* out, V* work) const {
    if (tables_.is_leaf(level)) {
      return leaf(in, stride, out, 1, [&](int i) { return tables_.leaf_iii(i); });
    }
    const int n = tables_.length(level);
    const int half = n / 2;
    type_iii(level + 1, in, 2 * stride, work, work + n);
    type_iv(level + 1, in + stride, 2 * stride, work + half, 1, work + n);
    for (int i = 0; i < half; ++i) {
      out[i] = L::add(work[i], work[half + i]);
      out[n - 1 - i] = L::sub(work[i], work[half + i]);
    }
  }

  // A type IV is its own transpose, so it serves both directions.
  void type_iv(size_t level, const V* in, int in_stride, V* out, int stride, V* work) const {
    if (tables_.is_leaf(level)) {
      return leaf(in, in_stride, out, stride, [&](int k) { return tables_.leaf_iv(k); });
    }
    const int m = tables_.length(level);
    const int half = m / 2;
    const CosineTables::Rotation* rotation = tables_.rotation(level);
    for (int i = 0; i < half; ++i) {
      const CosineTables::Rotation& r = rotation[i];
      const V a = in[i * in_stride];
      const V b = in[(m - 1 - i) * in_stride];
      work[i] = L::template narrow<kFraction>(L::add_scaled(L::scale(a, r.c), b, r.s));
      work[half + i] = L::template narrow<kFraction>(L::add_scaled(L::scale(a, r.w_a), b, r.w_b));
    }
    V* u = work + m;
    V* w = u + half;
    type_ii(level + 1, work, u, 1, work + 2 * m);
    type_ii(level + 1, work + half, w, 1, work + 2 * m);
    out[0] = u[0];
    for (int k = 1; k < half; ++k) {
      out[2 * k * stride] = L::add(u[k], w[half - k]);
      out[(2 * k - 1) * stride] = L::sub(u[k], w[half - k]);
    }
    out[(m - 1) * stride] = L::sub(L::broadcast(0), w[0]);
  }

  const CosineTables& tables_;
};

}  // namespace ruffini
