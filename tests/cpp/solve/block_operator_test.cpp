#include "solve/block_operator.h"

#include <gtest/gtest.h>

#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

// Owns the bytes that an operator looks into.
struct Loaded {
  std::vector<uint64_t> storage;
  Calibration calibration;

  explicit Loaded(const std::vector<uint8_t>& bytes) : storage((bytes.size() + 7) / 8) {
    std::memcpy(storage.data(), bytes.data(), bytes.size());
    auto parsed = Calibration::parse({reinterpret_cast<const uint8_t*>(storage.data()), bytes.size()});
    EXPECT_TRUE(parsed.has_value()) << (parsed ? "" : parsed.error().message);
    calibration = std::move(parsed).value();
  }
};

// 2 x 33 columns, so two blocks: row 0 counts block 0 once and block 1 four times, row 1 is -1 everywhere.
std::vector<uint8_t> example(std::vector<int16_t> entry, std::vector<uint8_t> shift, const char* out_shift) {
  return test::CalibrationBytes()
      .meta("kinds", "operator")
      .meta("operator.out_shift", out_shift)
      .tensor("operator.entry", "I16", {2, 64}, entry)
      .tensor("operator.shift", "U8", {2, 2}, shift)
      .bytes();
}

std::vector<int16_t> example_entry() {
  std::vector<int16_t> entry(128);
  for (size_t j = 0; j < 33; ++j) {
    entry[j] = 1;
    entry[64 + j] = -1;
  }
  return entry;
}

std::vector<int16_t> padded(int16_t value) {
  std::vector<int16_t> u(64);
  std::fill_n(u.begin(), 33, value);
  return u;
}

TEST(BlockOperator, ScalesEachBlockAndRoundsHalfUp) {
  const Loaded file(example(example_entry(), {0, 2, 0, 0}, "1"));
  const auto op = BlockOperator::load(file.calibration, "operator", 2, 33);
  ASSERT_TRUE(op.has_value());
  EXPECT_EQ(op.value().row(0, padded(1)), 18);   // (32 + 4) / 2
  EXPECT_EQ(op.value().row(1, padded(1)), -16);  // -33 / 2 = -16.5, half up
  EXPECT_EQ(op.value().row(1, padded(-1)), 17);  // 16.5, half up
  EXPECT_EQ(op.value().row(0, padded(-32768)), -589'824);
}

TEST(BlockOperator, SomeBlocksOnlyIsTheSameWhereTheOthersAreZero) {
  const Loaded file(example(example_entry(), {0, 2, 0, 0}, "1"));
  const auto op = BlockOperator::load(file.calibration, "operator", 2, 33);
  ASSERT_TRUE(op.has_value());
  std::vector<int16_t> u(64);
  u[32] = 100;
  const std::vector<uint16_t> second = {1};
  EXPECT_EQ(op.value().row(0, u, second), op.value().row(0, u));
  EXPECT_EQ(op.value().row(0, u), 200);
}

TEST(BlockOperator, LargestEntriesTimesLargestDisplacementsDoNotOverflow) {
  const Loaded file(example(std::vector<int16_t>(128, 16383), {27, 27, 0, 0}, "40"));
  const auto op = BlockOperator::load(file.calibration, "operator", 2, 64);
  ASSERT_TRUE(op.has_value());
  const std::vector<int16_t> u(64, -32768);
  // 64 x 16383 x -32768 x 2^27 / 2^40 = -(2^20 - 64) x 2^15 / 2^13 = -(4194304 - 256)
  EXPECT_EQ(op.value().row(0, u), -4'194'048);
}

TEST(BlockOperator, RefusesWhatCouldOverflowAndWhatIsMissing) {
  auto too_large = example_entry();
  too_large[5] = 16'384;
  const std::vector<std::vector<uint8_t>> bad = {
      example(too_large, {0, 0, 0, 0}, "1"),
      example(example_entry(), {28, 28, 0, 0}, "1"),
      example(example_entry(), {0, 0, 0, 0}, "0"),
      example(example_entry(), {0, 0, 0, 0}, "61"),
  };
  for (const auto& bytes : bad) {
    const Loaded file(bytes);
    EXPECT_FALSE(BlockOperator::load(file.calibration, "operator", 2, 33).has_value());
  }
  const Loaded file(example(example_entry(), {0, 0, 0, 0}, "1"));
  EXPECT_FALSE(BlockOperator::load(file.calibration, "h", 2, 33).has_value());
  EXPECT_FALSE(BlockOperator::load(file.calibration, "operator", 3, 33).has_value());
  EXPECT_FALSE(BlockOperator::load(file.calibration, "operator", 2, 65).has_value());
}

}  // namespace
}  // namespace ruffini
