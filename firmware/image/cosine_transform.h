// Cosine transforms of length n, processing as many rows at once as there are lanes.
//
//   forward   X_k = sum_i x_i cos(pi k (2 i + 1) / (2 n))          (type II)
//   inverse   x_i = sum_k X_k cos(pi k (2 i + 1) / (2 n))          (type III; scaling is the caller's)
//
// An even n is split: sums and differences of mirrored positions give II(n) = II(n/2) and IV(n/2), interleaved; III(n)
// likewise. A type IV of even length m is m/2 rotations by pi (2 i + 1) / (4 m), two II(m/2) and m/2 - 1 sums and
// differences. Odd lengths, the leaves, are plain sums of products. Coefficients are Q30; each rotation and each leaf
// rounds once, half up. Lengths of 10, which all common pictures come down to, are computed in registers from two
// leaves of 5: the same sums by their coefficients' symmetries, which are exact in integers (OfFive).
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

  // With C(j) = cos(pi j / 20), Q30:
  struct OfFive {
    int32_t c2, c4, c6, c8;
    int32_t c5, c5_twice;
    int32_t sum_1_9, difference_1_9, sum_3_7, difference_3_7;  // C(1) +- C(9), C(3) +- C(7): below 2
  };

  [[nodiscard]] int length(size_t level) const { return n_ >> level; }
  [[nodiscard]] int leaf_length() const { return leaf_n_; }
  // True for the length 10 above leaves of length 5.
  [[nodiscard]] bool is_two_fives(size_t level) const { return n_ >> level == 10; }
  [[nodiscard]] const OfFive& of_five() const { return of_five_; }
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
  OfFive of_five_;
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
    if (tables_.leaf_length() == 3) return sums_of_products<3>(in, in_stride, out, stride, row);  // unrolled
    sums_of_products<0>(in, in_stride, out, stride, row);
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

  static V narrow(typename L::Wide sum) { return L::template narrow<kFraction>(sum); }

  // II(5), whose coefficients are C(2 k (2 i + 1)): C(0) = 1, C(10) = 0, C(20 - j) = -C(j), and whole inputs need no
  // rounding.
  void ii_5(const V* x, V* out) const {
    const CosineTables::OfFive& c = tables_.of_five();
    const V s_0 = L::add(x[0], x[4]);
    const V s_1 = L::add(x[1], x[3]);
    const V d_0 = L::sub(x[0], x[4]);
    const V d_1 = L::sub(x[1], x[3]);
    out[0] = L::add(L::add(s_0, s_1), x[2]);
    out[1] = narrow(L::add_scaled(L::scale(d_0, c.c2), d_1, c.c6));
    out[2] = L::sub(narrow(L::sub_scaled(L::scale(s_0, c.c4), s_1, c.c8)), x[2]);
    out[3] = narrow(L::sub_scaled(L::scale(d_0, c.c6), d_1, c.c2));
    out[4] = L::add(narrow(L::sub_scaled(L::scale(s_0, c.c8), s_1, c.c4)), x[2]);
  }

  // III(5), the transpose of II(5).
  void iii_5(const V* x, V* out) const {
    const CosineTables::OfFive& c = tables_.of_five();
    const auto even_0 = L::add_scaled(L::scale(x[2], c.c4), x[4], c.c8);
    const auto minus_even_1 = L::add_scaled(L::scale(x[2], c.c8), x[4], c.c4);
    const auto odd_0 = L::add_scaled(L::scale(x[1], c.c2), x[3], c.c6);
    const auto odd_1 = L::sub_scaled(L::scale(x[1], c.c6), x[3], c.c2);
    const auto minus_odd_1 = L::sub_scaled(L::scale(x[3], c.c2), x[1], c.c6);
    out[0] = L::add(x[0], narrow(L::add_wide(even_0, odd_0)));
    out[1] = L::add(x[0], narrow(L::sub_wide(odd_1, minus_even_1)));
    out[2] = L::add(L::sub(x[0], x[2]), x[4]);
    out[3] = L::add(x[0], narrow(L::sub_wide(minus_odd_1, minus_even_1)));
    out[4] = L::add(x[0], narrow(L::sub_wide(even_0, odd_0)));
  }

  // IV(5): twice the outputs 0 and 4, and 1 and 3, are a sum and a difference of their own sum and difference, each of
  // which needs half as many products.
  void iv_5(const V* x, V* out) const {
    const CosineTables::OfFive& c = tables_.of_five();
    const V s_0 = L::add(x[0], x[4]);
    const V s_1 = L::add(x[1], x[3]);
    const V d_0 = L::sub(x[0], x[4]);
    const V d_1 = L::sub(x[1], x[3]);
    const auto middle = L::scale(x[2], c.c5_twice);
    const auto sum_04 = L::add_wide(L::add_scaled(L::scale(s_0, c.sum_1_9), d_1, c.difference_3_7), middle);
    const auto difference_04 = L::add_scaled(L::scale(d_0, c.difference_1_9), s_1, c.sum_3_7);
    const auto sum_13 = L::sub_scaled(L::scale(d_0, c.sum_3_7), s_1, c.difference_1_9);
    const auto difference_13 = L::sub_wide(L::add_scaled(L::scale(s_0, c.difference_3_7), d_1, c.sum_1_9), middle);
    out[0] = L::template narrow<kFraction + 1>(L::add_wide(sum_04, difference_04));
    out[1] = L::template narrow<kFraction + 1>(L::add_wide(sum_13, difference_13));
    out[2] = narrow(L::scale(L::sub(L::sub(s_0, d_1), x[2]), c.c5));
    out[3] = L::template narrow<kFraction + 1>(L::sub_wide(sum_13, difference_13));
    out[4] = L::template narrow<kFraction + 1>(L::sub_wide(sum_04, difference_04));
  }

  void ii_10(const V* in, V* out, int stride) const {
    V sum[5], difference[5], even[5], odd[5];
    for (int i = 0; i < 5; ++i) {
      sum[i] = L::add(in[i], in[9 - i]);
      difference[i] = L::sub(in[i], in[9 - i]);
    }
    ii_5(sum, even);
    iv_5(difference, odd);
    for (int k = 0; k < 5; ++k) {
      out[2 * k * stride] = even[k];
      out[(2 * k + 1) * stride] = odd[k];
    }
  }

  void iii_10(const V* in, int stride, V* out) const {
    V even[5], odd[5], sum[5], difference[5];
    for (int k = 0; k < 5; ++k) {
      even[k] = in[2 * k * stride];
      odd[k] = in[(2 * k + 1) * stride];
    }
    iii_5(even, sum);
    iv_5(odd, difference);
    for (int i = 0; i < 5; ++i) {
      out[i] = L::add(sum[i], difference[i]);
      out[9 - i] = L::sub(sum[i], difference[i]);
    }
  }

  void iv_10(const CosineTables::Rotation* rotation, const V* in, int in_stride, V* out, int stride) const {
    V a[5], b[5], u[5], w[5];
    for (int i = 0; i < 5; ++i) rotate(rotation[i], in[i * in_stride], in[(9 - i) * in_stride], a[i], b[i]);
    ii_5(a, u);
    ii_5(b, w);
    merge<5>(u, w, 5, out, stride);
  }

  static void rotate(const CosineTables::Rotation& r, V a, V b, V& u, V& w) {
    u = narrow(L::add_scaled(L::scale(a, r.c), b, r.s));
    w = narrow(L::add_scaled(L::scale(a, r.w_a), b, r.w_b));
  }

  // The last step of a type IV, from two type II of its halves. kHalf: `half` if it is known when compiled, else 0.
  template <int kHalf>
  static void merge(const V* u, const V* w, int half, V* out, int stride) {
    const int n = kHalf > 0 ? kHalf : half;
    out[0] = u[0];
    for (int k = 1; k < n; ++k) {
      out[2 * k * stride] = L::add(u[k], w[n - k]);
      out[(2 * k - 1) * stride] = L::sub(u[k], w[n - k]);
    }
    out[(2 * n - 1) * stride] = L::sub(L::broadcast(0), w[0]);
  }

  void type_ii(size_t level, const V* in, V* out, int stride, V* work) const {
    if (tables_.is_two_fives(level)) return ii_10(in, out, stride);
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
    if (tables_.is_two_fives(level)) return iii_10(in, stride, out);
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
    if (tables_.is_two_fives(level)) return iv_10(rotation, in, in_stride, out, stride);
    for (int i = 0; i < half; ++i) {
      rotate(rotation[i], in[i * in_stride], in[(m - 1 - i) * in_stride], work[i], work[half + i]);
    }
    V* u = work + m;
    V* w = u + half;
    type_ii(level + 1, work, u, 1, work + 2 * m);
    type_ii(level + 1, work + half, w, 1, work + 2 * m);
    merge<0>(u, w, half, out, stride);
  }

  const CosineTables& tables_;
};

}  // namespace ruffini
