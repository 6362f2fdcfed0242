#include "store/calibration.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string_view>

#include "support/calibration_bytes.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

// Keeps the bytes aligned beside what points into them.
struct Parsed {
  explicit Parsed(const std::vector<uint8_t>& bytes) : storage((bytes.size() + 7) / 8) {
    if (!bytes.empty()) std::memcpy(storage.data(), bytes.data(), bytes.size());
    result.emplace(Calibration::parse({reinterpret_cast<const uint8_t*>(storage.data()), bytes.size()}));
  }
  std::vector<uint64_t> storage;
  std::optional<Result<Calibration>> result;
};

std::vector<uint8_t> operator_file(int16_t entry, uint8_t shift) {
  return test::CalibrationBytes()
      .meta("kinds", "operator")
      .meta("operator.out_shift", "4")
      .tensor("operator.entry", "I16", {2, 64}, std::vector<int16_t>(128, entry))
      .tensor("operator.shift", "U8", {2, 2}, std::vector<uint8_t>(4, shift))
      .bytes();
}

TEST(Calibration, ReadsWhatWasWritten) {
  const Parsed file(operator_file(5, 3));
  ASSERT_TRUE(*file.result) << file.result->error().message;
  const Calibration& c = file.result->value();
  EXPECT_EQ(c.text("operator.out_shift"), "4");
  EXPECT_EQ(c.text("nothing"), "");
  EXPECT_EQ(c.integer("operator.out_shift", 0, 10).value(), 4);
  EXPECT_FALSE(c.integer("operator.out_shift", 5, 10));
  EXPECT_EQ(c.tensor("operator.entry")->as<int16_t>()[127], 5);
  EXPECT_FALSE(c.tensor("operator.entry", Tensor::Type::kI16, {64, 2}));
  EXPECT_FALSE(c.tensor("operator.entry", Tensor::Type::kU16, {2, 64}));
  EXPECT_EQ(c.signature().size(), 64U);
  EXPECT_EQ(c.signed_bytes().data() + c.signed_bytes().size(), c.signature().data())
      << "the signature covers all before it";
}

TEST(Calibration, EveryTruncationIsRefused) {
  const std::vector<uint8_t> whole = operator_file(5, 3);
  for (size_t n = 0; n < whole.size(); ++n) {
    EXPECT_FALSE(*Parsed({whole.begin(), whole.begin() + static_cast<ptrdiff_t>(n)}).result) << n;
  }
}

TEST(Calibration, BytesAfterTheLastTensorAreRefused) {
  std::vector<uint8_t> bytes = operator_file(5, 3);
  bytes.resize(bytes.size() + 8);
  EXPECT_FALSE(*Parsed(bytes).result);
}

TEST(Calibration, TensorsThatOverlapAreRefused) {
  std::vector<uint8_t> bytes = operator_file(5, 3);
  const std::string_view theirs = "[256,260]";
  const std::string_view overlapping = "[0,4]    ";
  const auto found = std::search(bytes.begin(), bytes.end(), theirs.begin(), theirs.end());
  ASSERT_NE(found, bytes.end());
  std::copy(overlapping.begin(), overlapping.end(), found);
  EXPECT_FALSE(*Parsed(bytes).result);
}

// The signature is checked elsewhere: here no spoilt byte may reach beyond the file, under the sanitizers.
TEST(Calibration, EverySpoiltByteIsRefusedOrStaysInsideTheFile) {
  std::vector<uint8_t> bytes = operator_file(5, 3);
  for (size_t at = 0; at < bytes.size(); ++at) {
    for (const unsigned flip : {1U, 0x10U, 0x80U, 0xFFU}) {
      bytes[at] = static_cast<uint8_t>(bytes[at] ^ flip);
      const Parsed file(bytes);
      if (*file.result) {
        if (const Tensor* t = file.result->value().tensor("operator.entry")) {
          ASSERT_GE(t->bytes.data(), reinterpret_cast<const uint8_t*>(file.storage.data()));
          ASSERT_LE(t->bytes.data() + t->bytes.size(),
                    reinterpret_cast<const uint8_t*>(file.storage.data()) + bytes.size());
        }
      }
      bytes[at] = static_cast<uint8_t>(bytes[at] ^ flip);
    }
  }
}

// What a file says when it is refused; "" when it is read.
std::string refusal(test::CalibrationBytes file) {
  const Parsed parsed(file.bytes());
  return *parsed.result ? "" : parsed.result->error().message;
}

TEST(Calibration, WhatThisFirmwareDoesNotKnowIsRefused) {
  const std::vector<uint8_t> values(16);
  const auto file = [](const char* kinds) { return std::move(test::CalibrationBytes().meta("kinds", kinds)); };
  EXPECT_EQ(refusal(file("operator").tensor("operator.shift", "U8", {16}, values)), "");
  EXPECT_EQ(refusal(file("operator,rest").tensor("operator.shift", "U8", {16}, values)), "");
  EXPECT_NE(refusal(file("magic").tensor("magic.wand", "U8", {16}, values)).find("\"magic\""), std::string::npos);
  EXPECT_NE(refusal(file("rest").tensor("operator.shift", "U8", {16}, values)).find("operator.shift"),
            std::string::npos);
  EXPECT_NE(refusal(file("rest").tensor("rest.image", "F32", {4}, values)).find("F32"), std::string::npos);
  EXPECT_NE(refusal(file("rest").tensor("rest.image", "I32", {2, 3}, values)).find("rest.image"), std::string::npos);
  EXPECT_NE(refusal(file("rest").tensor("rest", "U8", {16}, values).tensor("rest", "U8", {16}, values)).find("dupl"),
            std::string::npos);
  EXPECT_NE(refusal(file("rest").meta("kinds", "rest")).find("kinds"), std::string::npos);
  EXPECT_NE(refusal(file("").meta("board", "\\u0041")).find("__metadata__"), std::string::npos);
  EXPECT_NE(refusal(file("").meta("board", "gr\xC3\xBCn")).find("ASCII"), std::string::npos);
}

TEST(Calibration, LengthsThatOverflowAreRefused) {
  const std::vector<uint8_t> values(16);
  for (const int n : {0, 17, 1 << 30}) {
    EXPECT_NE(refusal(std::move(test::CalibrationBytes().meta("kinds", "rest").tensor("rest.x", "U8", {n}, values))),
              "");
  }
  // 2^30 x 2^30 x 2^30 x 16 is 0 in 64 bits.
  EXPECT_NE(refusal(std::move(test::CalibrationBytes()
                                  .meta("kinds", "rest")
                                  .tensor("rest.x", "U8", {1 << 30, 1 << 30, 1 << 30, 16}, std::vector<uint8_t>()))),
            "");
  std::vector<uint8_t> bytes = operator_file(5, 3);
  for (const uint8_t high : std::vector<uint8_t>{0x01, 0x7F, 0xFF}) {
    bytes[7] = high;  // a header of more than 2^56 bytes
    EXPECT_FALSE(*Parsed(bytes).result);
  }
}

TEST(Calibration, AnotherBoardResolutionOrSensorIsRefusedByName) {
  BoardSettings board = test::round_board();
  board.stages = stage_names();
  const Parsed file(test::diagonal_calibration(board));
  ASSERT_TRUE(*file.result) << file.result->error().message;
  const Calibration& c = file.result->value();
  EXPECT_TRUE(c.check_target(board, "0001"));
  BoardSettings other = board;
  other.name = "square";
  const Status wrong = c.check_target(other, "0001");
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().kind, ErrorKind::kRefused);
  EXPECT_NE(wrong.error().message.find("round"), std::string::npos) << wrong.error().message;
  other = board;
  other.camera.width_px = 320;
  EXPECT_FALSE(c.check_target(other, "0001"));

  auto of_one_sensor = test::CalibrationBytes();
  of_one_sensor.meta("kinds", "operator").meta("board", board.name).meta("sensor_serial", "0001");
  of_one_sensor.meta("resolution",
                     std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px));
  const Parsed own(of_one_sensor.tensor("operator.shift", "U8", {8}, std::vector<uint8_t>(8)).bytes());
  ASSERT_TRUE(*own.result) << own.result->error().message;
  EXPECT_TRUE(own.result->value().check_target(board, "0001"));
  EXPECT_FALSE(own.result->value().check_target(board, "0002"));
}

}  // namespace
}  // namespace ruffini
