#include "link/dense_codec.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>

#include "support/vectors.h"

namespace ruffini {
namespace {

std::vector<int32_t> numbers(const std::string& text) {
  std::vector<int32_t> out;
  std::stringstream in(text);
  for (std::string number; std::getline(in, number, ',');) out.push_back(static_cast<int32_t>(std::stol(number)));
  return out;
}

// The encoder chooses the codec itself, so only the vectors of its choice are compared byte for byte.
TEST(DenseCodec, EncodesTheGoldenValuesByteForByte) {
  int n = 0;
  for (const auto& v : test::read_vectors(RUFFINI_VECTORS_DIR "/dense.txt")) {
    ASSERT_EQ(v.size(), 6U);
    if (v[5] == "error") continue;
    const std::vector<int32_t> values = numbers(v[5]);
    std::vector<uint8_t> out(dense_bound(values.size()));
    const DenseBytes made = encode_dense(values, std::stoul(v[3]), out);
    EXPECT_EQ(std::to_string(static_cast<int>(made.codec)), v[1]) << v[0];
    out.resize(made.n_bytes);
    EXPECT_EQ(test::to_hex(out), v[4]) << v[0];
    ++n;
  }
  EXPECT_GE(n, 11);
}

TEST(DenseCodec, TheBoundHoldsForTheWorstValues) {
  for (const size_t n : {size_t{1}, size_t{31}, size_t{32}, size_t{33}, size_t{1000}}) {
    const std::vector<int32_t> values(n, INT32_MIN);
    std::vector<uint8_t> out(dense_bound(n));
    EXPECT_LE(encode_dense(values, 1, out).n_bytes, out.size());
  }
}

TEST(DenseCodec, TheBitmapComesWhenAnEighthOfTheNodesIsStill) {
  std::vector<int32_t> values(16 * 3, 1);
  std::vector<uint8_t> out(dense_bound(values.size()));
  std::fill_n(values.begin(), 2 * 3, 0);
  EXPECT_EQ(encode_dense(values, 3, out).codec, DenseCodec::kPacked);
  std::fill_n(values.begin(), 3 * 3, 0);
  EXPECT_EQ(encode_dense(values, 3, out).codec, DenseCodec::kSparse);
}

}  // namespace
}  // namespace ruffini
