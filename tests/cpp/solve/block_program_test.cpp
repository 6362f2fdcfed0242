#include "solve/block_program.h"

#include <gtest/gtest.h>

#include <random>

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

// Two stages over 96 values, in panels of 12 and 20 rows that read parts of the vectors.
std::vector<uint8_t> two_stages(std::minstd_rand& random) {
  const auto drawn = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  std::vector<int32_t> fold(size_t{96} * 2);
  for (int32_t& i : fold) i = drawn(193) - 96;
  std::vector<int16_t> entry(size_t{(12 + 20 + 20 + 12) * 2} * 32);
  for (int16_t& q : entry) q = static_cast<int16_t>(drawn(2001) - 1000);
  std::vector<uint8_t> shift(entry.size() / 32);
  for (uint8_t& s : shift) s = static_cast<uint8_t>(drawn(4));
  return test::CalibrationBytes()
      .meta("kinds", "operator")
      .meta("operator.out_shift", "3")
      .tensor("operator.fold", "I32", {96, 2}, fold)
      .tensor("operator.stage", "I32", {2, 2}, std::vector<int32_t>{32, 9, 32, 0})
      .tensor("operator.panel", "I32", {4, 6},
              std::vector<int32_t>{0, 0, 12, 0, 0, 2, 0, 12, 20, 0, 2, 1, 1, 0, 20, 0, 3, 2, 1, 20, 12, 1, 5, 2})
      .tensor("operator.segment", "I32", {7, 2},
              std::vector<int32_t>{0, 20, 30, 30, 56, 40, 5, 20, 60, 30, 3, 15, 14, 18})
      .tensor("operator.unfold", "I32", {96, 2},
              [&] {
                for (int32_t& i : fold) i = drawn(65) - 32;
                return fold;
              }())
      .tensor("operator.entry", "I16", {static_cast<int>(entry.size())}, entry)
      .tensor("operator.shift", "U8", {static_cast<int>(shift.size())}, shift)
      .bytes();
}

TEST(BlockProgram, SelectedInputsGiveWhatAllGiveWithTheOthersZero) {
  std::minstd_rand random(1);
  for (int round = 0; round < 50; ++round) {
    const Loaded file(two_stages(random));
    const auto loaded = file.program(96, 96);
    ASSERT_TRUE(loaded.has_value()) << loaded.error().message;
    BlockProgram selective = loaded.value();
    for (const unsigned one_in : {1U, 4U, 50U, 3U}) {
      std::vector<uint32_t> inputs;
      std::vector<uint32_t> outputs;
      std::vector<int16_t> u(96);
      std::vector<int16_t> with_zeros(96);
      for (uint32_t i = 0; i < 96; ++i) {
        u[i] = static_cast<int16_t>(random() % 60'000);
        if (random() % 3 == 0) outputs.push_back(i);
        if (random() % one_in != 0) continue;
        inputs.push_back(i);
        with_zeros[i] = u[i];
      }
      const std::vector<int64_t> expected = run(loaded.value(), with_zeros);
      std::vector<int64_t> found(96);
      selective.select(outputs, inputs);
      selective.run(u, found);
      for (const uint32_t i : outputs) EXPECT_EQ(found[i], expected[i]);
      selective.select(outputs);
      selective.run(with_zeros, found);
      for (const uint32_t i : outputs) EXPECT_EQ(found[i], expected[i]);
    }
  }
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
