#include "solve/block_program.h"

#include <gtest/gtest.h>

#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

// Owns the bytes that a program looks into.
struct Loaded {
  std::vector<uint64_t> storage;
  Calibration calibration;

  explicit Loaded(const std::vector<uint8_t>& bytes) : storage((bytes.size() + 7) / 8) {
    std::memcpy(storage.data(), bytes.data(), bytes.size());
    auto parsed = Calibration::parse({reinterpret_cast<const uint8_t*>(storage.data()), bytes.size()});
    EXPECT_TRUE(parsed.has_value()) << (parsed ? "" : parsed.error().message);
    calibration = std::move(parsed).value();
  }
  [[nodiscard]] Result<BlockProgram> program(int n_in, int n_out) const {
    return BlockProgram::load(calibration, "operator", n_in, n_out);
  }
};

// 2 x 33, so two blocks; row 0 is 1 everywhere, row 1 is -1.
std::vector<uint8_t> dense(const std::vector<uint8_t>& shift, const char* out_shift, int16_t entry = 1) {
  std::vector<int16_t> rows(66, entry);
  std::fill(rows.begin() + 33, rows.end(), static_cast<int16_t>(-entry));
  return test::CalibrationBytes()
      .meta("kinds", "operator")
      .meta("operator.out_shift", out_shift)
      .dense_program("operator", 2, 33)
      .dense_entries("operator", 2, 33, rows)
      .tensor("operator.shift", "U8", {4}, shift)
      .bytes();
}

std::vector<int64_t> run(BlockProgram program, const std::vector<int16_t>& u) {
  std::vector<int64_t> out(static_cast<size_t>(program.n_out()));
  program.run(u, out);
  return out;
}

TEST(BlockProgram, ScalesEachBlockAndRoundsHalfUp) {
  const Loaded file(dense({0, 0, 2, 0}, "1"));  // row 0 counts its second block four times
  const auto program = file.program(33, 2);
  ASSERT_TRUE(program.has_value()) << program.error().message;
  EXPECT_EQ(run(program.value(), std::vector<int16_t>(33, 1)), (std::vector<int64_t>{18, -16}));  // 36 / 2, -16.5
  EXPECT_EQ(run(program.value(), std::vector<int16_t>(33, -1)), (std::vector<int64_t>{-18, 17}));
  EXPECT_EQ(run(program.value(), std::vector<int16_t>(33, -32768)), (std::vector<int64_t>{-589'824, 540'672}));
}

TEST(BlockProgram, ZeroInputsAreZero) {
  const Loaded file(dense({0, 0, 0, 0}, "1"));
  EXPECT_EQ(run(file.program(33, 2).value(), std::vector<int16_t>(33)), (std::vector<int64_t>{0, 0}));
}

TEST(BlockProgram, LargestEntriesTimesLargestInputsDoNotOverflow) {
  const Loaded file(dense({27, 27, 27, 27}, "40", 16'383));
  const auto program = file.program(33, 2);
  ASSERT_TRUE(program.has_value()) << program.error().message;
  // 33 x 16383 x 32768 x 2^27 / 2^40 = 33 x 16383 x 4
  EXPECT_EQ(run(program.value(), std::vector<int16_t>(33, -32768)), (std::vector<int64_t>{-2'162'556, 2'162'556}));
}

// x = (u0 + u1, u0 - u1); x'_0 = 3 x_0, x'_1 = 5 x_1; outputs (x'_0 + x'_1, x'_0 - x'_1) / 2.
TEST(BlockProgram, FoldsAndUnfolds) {
  std::vector<int16_t> entry(64);
  entry[0] = 3;
  entry[33] = 5;
  const Loaded file(test::CalibrationBytes()
                        .meta("kinds", "operator")
                        .meta("operator.out_shift", "1")
                        .tensor("operator.fold", "I32", {2, 2}, std::vector<int32_t>{1, 2, 1, -2})
                        .tensor("operator.panel", "I32", {1, 6}, std::vector<int32_t>{0, 0, 2, 0, 0, 1})
                        .tensor("operator.segment", "I32", {1, 2}, std::vector<int32_t>{0, 2})
                        .tensor("operator.stage", "I32", {1, 2}, std::vector<int32_t>{2, 0})
                        .tensor("operator.unfold", "I32", {2, 2}, std::vector<int32_t>{1, 2, 1, -2})
                        .tensor("operator.entry", "I16", {64}, entry)
                        .tensor("operator.shift", "U8", {2}, std::vector<uint8_t>(2))
                        .bytes());
  const auto program = file.program(2, 2);
  ASSERT_TRUE(program.has_value()) << program.error().message;
  EXPECT_EQ(run(program.value(), {10, 4}), (std::vector<int64_t>{36, 6}));  // (42 +- 30) / 2
  // 60000 is kept as 30000 with one exponent.
  EXPECT_EQ(run(program.value(), {30'000, 30'000}), (std::vector<int64_t>{90'000, 90'000}));
}

TEST(BlockProgram, RefusesWhatCouldOverflowAndWhatIsMissing) {
  const std::vector<std::vector<uint8_t>> bad = {
      dense({0, 0, 0, 0}, "1", 16'384),
      dense({41, 0, 0, 0}, "1"),
      dense({30, 30, 30, 30}, "1", 16'383),  // 33 x 16383 x 2^30 x 32770 > 2^62
      dense({0, 0, 0, 0}, "0"),
      dense({0, 0, 0, 0}, "61"),
  };
  for (const auto& bytes : bad) EXPECT_FALSE(Loaded(bytes).program(33, 2).has_value());
  const Loaded file(dense({0, 0, 0, 0}, "1"));
  EXPECT_TRUE(file.program(33, 2).has_value());
  EXPECT_FALSE(BlockProgram::load(file.calibration, "h", 33, 2).has_value());
  EXPECT_FALSE(file.program(32, 2).has_value());
  EXPECT_FALSE(file.program(33, 3).has_value());
}

}  // namespace
}  // namespace ruffini
