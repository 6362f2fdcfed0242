#include "link/session.h"

#include <gtest/gtest.h>
#include <pb_decode.h>
#include <pb_encode.h>

#include <array>
#include <filesystem>

#include "link/messages.h"
#include "support/install.h"
#include "support/session_fixture.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::host_frame;
class SessionTest : public test::SessionTest {};

// The numbers of the firmware's own enumerations are those of the schema.
static_assert(uint32_t{kFlagNoReference} == uint32_t{ruffini_FlagBit_FLAG_NO_REFERENCE});
static_assert(uint32_t{kFlagUncalibratedXy} == uint32_t{ruffini_FlagBit_FLAG_UNCALIBRATED_XY});
static_assert(uint32_t{kFlagUncalibratedZ} == uint32_t{ruffini_FlagBit_FLAG_UNCALIBRATED_Z});
static_assert(uint32_t{kFlagMarkersLost} == uint32_t{ruffini_FlagBit_FLAG_MARKERS_LOST});
static_assert(uint32_t{kFlagSaturated} == uint32_t{ruffini_FlagBit_FLAG_SATURATED});
static_assert(uint32_t{kFlagOverRange} == uint32_t{ruffini_FlagBit_FLAG_OVER_RANGE});
static_assert(uint32_t{kFlagDark} == uint32_t{ruffini_FlagBit_FLAG_DARK});
static_assert(uint32_t{kFlagOverexposed} == uint32_t{ruffini_FlagBit_FLAG_OVEREXPOSED});
static_assert(uint32_t{kFlagWindowBorder} == uint32_t{ruffini_FlagBit_FLAG_WINDOW_BORDER});
static_assert(uint32_t{kFlagLight} == uint32_t{ruffini_FlagBit_FLAG_LIGHT});
static_assert(static_cast<int>(Validity::kNotMeasured) == ruffini_Validity_VALIDITY_NOT_MEASURED);
static_assert(static_cast<int>(Validity::kValid) == ruffini_Validity_VALIDITY_VALID);
static_assert(static_cast<int>(Validity::kUncalibrated) == ruffini_Validity_VALIDITY_UNCALIBRATED);
static_assert(static_cast<int>(Validity::kInvalid) == ruffini_Validity_VALIDITY_INVALID);

TEST_F(SessionTest, HelloSaysWhoIsThereAndThatItIsSimulated) {
  const auto answers = ask(ruffini_MessageType_MESSAGE_TYPE_HELLO);
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].header.flags, kSimulated);
  EXPECT_EQ(answers[0].header.sensor, kDeviceSensor);
  ruffini_Hello hello = ruffini_Hello_init_zero;
  pb_istream_t in = pb_istream_from_buffer(answers[0].payload.data(), answers[0].payload.size());
  ASSERT_TRUE(pb_decode(&in, ruffini_Hello_fields, &hello));
  EXPECT_STREQ(hello.device_serial, "0042");
  EXPECT_EQ(hello.protocol_version, kProtocolVersion);
  ASSERT_EQ(hello.sensors_count, 1);
  EXPECT_STREQ(hello.sensors[0].board, "gelslim");
  EXPECT_EQ(hello.sensors[0].board_toml, board_.toml);
  EXPECT_FALSE(hello.sensors[0].calibration.present);
}

TEST_F(SessionTest, ATextThatDoesNotFitIsCutBeforeAWholeCharacter) {
  const size_t room = sizeof ruffini_Hello::firmware_version - 1;
  const std::string version = std::string(room - 1, 'v') + "\u00e9";  // two bytes, one too many
  Session session(board_, *path_, {.serial = "0042", .version = version}, calibrator_, exchange_, {clock_, random_});
  session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  ruffini_Hello hello = ruffini_Hello_init_zero;
  for (const uint8_t byte : session.pending()) {
    if (const auto frame = decoder_.push(byte)) {
      pb_istream_t in = pb_istream_from_buffer(frame->payload.data(), frame->payload.size());
      ASSERT_TRUE(pb_decode(&in, ruffini_Hello_fields, &hello));
    }
  }
  EXPECT_EQ(std::string(hello.firmware_version), std::string(room - 1, 'v'));
}

TEST_F(SessionTest, ARetriedCommandIsAnsweredAndNotRunAgain) {
  ruffini_Command zero = request(9, ruffini_Command_zero_tag);
  zero.action.zero.n_frames = 5;
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.exchange(-1), 5);
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
}

TEST_F(SessionTest, ANewHostMayUseTheNumbersOfTheOneBefore) {
  ruffini_Command zero = request(9, ruffini_Command_zero_tag);
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  ask(ruffini_MessageType_MESSAGE_TYPE_HELLO);
  zero.action.zero.n_frames = 7;
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), 7);
}

TEST_F(SessionTest, ACommandForASensorThatIsNotHereIsRefused) {
  ruffini_Command zero = request(1, ruffini_Command_zero_tag);
  EXPECT_EQ(command(zero, 5).code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  zero.request_id = 2;
  EXPECT_EQ(command(zero, 0).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), 0);
}

TEST_F(SessionTest, WhatIsNoCommandGetsNoReplyAndIsCounted) {
  EXPECT_TRUE(ask(ruffini_MessageType_MESSAGE_TYPE_COMMAND, {0xFF, 0xFF, 0xFF}).empty());
  const Bytes half(2 * kMaxPayloadBytes);  // in fragments: no command is that long
  EXPECT_TRUE(ask(ruffini_MessageType_MESSAGE_TYPE_COMMAND, half).empty());
  EXPECT_EQ(status().drops.rx_malformed, 3U);
}

TEST_F(SessionTest, ATypeOfTheFutureIsPassedOver) {
  std::array<uint8_t, kMaxFrameBytes> frame{};
  const size_t n = encode_frame({kFromHost, _ruffini_MessageType_MAX + 1, kDeviceSensor, 0, 0, 1}, {}, frame);
  session_.receive({frame.data(), n});
  EXPECT_TRUE(read_all().empty());
  EXPECT_EQ(status().drops.rx_malformed, 0U);
}

TEST_F(SessionTest, AnUnknownCommandIsAnsweredAsUnknown) {
  EXPECT_EQ(command(request(3, 0)).code, ruffini_ReplyCode_REPLY_UNKNOWN_COMMAND);
}

TEST_F(SessionTest, AReplyIsTextWhateverTheKeyWas) {
  ruffini_Command get = request(4, ruffini_Command_get_tag);
  std::memcpy(get.action.get.key, "\xFFh\xC3i\n", 6);
  const ruffini_Reply reply = command(get);
  EXPECT_EQ(reply.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_NE(std::string(reply.text).find("\"?h?i?\""), std::string::npos) << reply.text;
}

TEST_F(SessionTest, HelloNamesEveryKindOfTheCalibrationInForce) {
  board_ = test::round_board();
  Calibrator calibrator(board_, "0042", SlotStore::open(folder_).value(), exchange_);
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, test::sign(test::diagonal_calibration(board_))));
  std::string problem;
  path_ = calibrator.start([] { return uint64_t{0}; }, problem).value();
  EXPECT_EQ(problem, "");
  Session session(board_, *path_, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
  session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  const std::span<const uint8_t> answer = session.pending();
  ruffini_Hello hello = ruffini_Hello_init_zero;
  for (const uint8_t byte : answer) {
    if (const auto frame = decoder_.push(byte)) {
      pb_istream_t in = pb_istream_from_buffer(frame->payload.data(), frame->payload.size());
      ASSERT_TRUE(pb_decode(&in, ruffini_Hello_fields, &hello));
    }
  }
  const ruffini_CalibrationInfo& info = hello.sensors[0].calibration;
  EXPECT_TRUE(info.present);
  EXPECT_TRUE(info.development_key);
  ASSERT_EQ(info.kinds_count, 3);
  EXPECT_STREQ(info.kinds[0], "operator");
  EXPECT_STREQ(info.kinds[2], "photometric");
}

TEST_F(SessionTest, SubscriptionsReplaceEachOtherAndIgnoreTypesOfTheFuture) {
  ruffini_Command m = request(1, ruffini_Command_subscribe_tag);
  m.action.subscribe.subscriptions_count = 2;
  m.action.subscribe.subscriptions[0] = {ruffini_MessageType_MESSAGE_TYPE_WRENCH, 1};
  m.action.subscribe.subscriptions[1] = {ruffini_MessageType_MESSAGE_TYPE_FIELD, 4};
  EXPECT_EQ(command(m).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.every[ruffini_MessageType_MESSAGE_TYPE_WRENCH].load(), 1U);
  EXPECT_EQ(exchange_.every[ruffini_MessageType_MESSAGE_TYPE_FIELD].load(), 4U);
  m.request_id = 2;
  m.action.subscribe.subscriptions_count = 1;
  const uint32_t future = 200;
  std::memcpy(&m.action.subscribe.subscriptions[0].type, &future, sizeof future);
  EXPECT_EQ(command(m).code, ruffini_ReplyCode_REPLY_OK);
  for (const auto& every : exchange_.every) EXPECT_EQ(every.load(), 0U);
}

TEST_F(SessionTest, FlashingNamesTheNextOffsetAndRefusesWhatIsNoCalibration) {
  const Bytes file(5'000, 0x42);
  ruffini_Command begin = request(1, ruffini_Command_flash_begin_tag);
  begin.action.flash_begin.size_bytes = file.size();
  begin.action.flash_begin.sha256.size = 32;
  const std::string hash = sha256(file);
  std::memcpy(begin.action.flash_begin.sha256.bytes, hash.data(), 32);
  EXPECT_EQ(command(begin).next_offset, 0U);
  ruffini_Command chunk = request(2, ruffini_Command_flash_chunk_tag);
  chunk.action.flash_chunk.data.size = 3'000;
  std::memset(chunk.action.flash_chunk.data.bytes, 0x42, 3'000);
  EXPECT_EQ(command(chunk).next_offset, 3'000U);
  chunk.request_id = 3;  // the same bytes again, as after a lost reply
  const ruffini_Reply again = command(chunk);
  EXPECT_EQ(again.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_EQ(again.next_offset, 3'000U);
  begin.request_id = 4;  // the same hash goes on where it was
  EXPECT_EQ(command(begin).next_offset, 3'000U);
  EXPECT_EQ(command(request(5, ruffini_Command_flash_commit_tag)).code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  chunk = request(6, ruffini_Command_flash_chunk_tag);
  chunk.action.flash_chunk.offset = 3'000;
  chunk.action.flash_chunk.data.size = 2'000;
  std::memset(chunk.action.flash_chunk.data.bytes, 0x42, 2'000);
  EXPECT_EQ(command(chunk).flash_state, ruffini_FlashState_FLASH_STATE_RECEIVED);
  const ruffini_Reply refused = command(request(7, ruffini_Command_flash_commit_tag));
  EXPECT_NE(refused.code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_NE(std::string(refused.text), "");
  EXPECT_EQ(exchange_.next_path.load(), nullptr);
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/calibration-1.safetensors"));
}

TEST_F(SessionTest, TheNewestTelemetryOfEachTypeWinsAndTheRestIsCounted) {
  session_.poll(1);
  read_all();
  for (uint8_t i = 1; i <= 5; ++i) push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {i});
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_FIELD, {99});
  session_.poll(2);
  Bytes sent;
  for (auto bytes = session_.pending(); !bytes.empty(); bytes = session_.pending()) {
    sent.insert(sent.end(), bytes.begin(), bytes.end());
    session_.consumed(bytes.size());
  }
  EXPECT_EQ(sent, (Bytes{5, 99}));
  EXPECT_EQ(exchange_.telemetry_dropped.load(), 4U);
}

TEST_F(SessionTest, RepliesGoBeforeTelemetryAndABegunFrameIsFinished) {
  session_.poll(1);
  read_all();
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_IMAGE, Bytes(100, 7));
  session_.poll(2);
  ASSERT_EQ(session_.pending().size(), 100U);
  session_.consumed(40);
  session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  EXPECT_EQ(session_.pending().size(), 60U);
  session_.consumed(60);
  const auto answers = read_all();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].header.type, ruffini_MessageType_MESSAGE_TYPE_HELLO);
}

TEST_F(SessionTest, ALostLineForgetsWhoSubscribed) {
  exchange_.every[4] = 1;
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {1});
  session_.poll(1);
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_FIELD, {2});
  session_.reset_line();
  EXPECT_EQ(exchange_.every[4].load(), 0U);
  session_.poll(2);
  EXPECT_TRUE(session_.pending().empty());
}

TEST_F(SessionTest, TheDevicesOwnFramesComingBackAreAnEcho) {
  Bytes own(frames_bound(0));
  own.resize(write_frames(ruffini_MessageType_MESSAGE_TYPE_HELLO, 0, kDeviceSensor, 0, {}, own));
  session_.receive(own);
  session_.poll(1);
  EXPECT_TRUE(session_.pending().empty());
  EXPECT_EQ(status().drops.rx_echo, 1U);
}

TEST_F(SessionTest, StatusSaysHowALearnedNetworkFares) {
  EXPECT_FALSE(status().has_network);
  NetworkHealth& network = exchange_.network;
  network.is_asked = true;
  network.sha256.fill(0xAB);
  network.results = 5;
  network.invalid = 2;
  network.skipped = 7;
  network.took_us = 11;
  network.latency_us = 13;
  network.period_us = 17;
  EXPECT_EQ(status().network.state, ruffini_NetworkState_NETWORK_STATE_LOADING);
  network.state = NetworkState::kRuns;
  ruffini_Status said = status();
  EXPECT_EQ(said.network.state, ruffini_NetworkState_NETWORK_STATE_RUNS);
  ASSERT_EQ(said.network.sha256.size, 32U);
  EXPECT_EQ(said.network.sha256.bytes[31], 0xAB);
  EXPECT_EQ(said.network.results, 5U);
  EXPECT_EQ(said.network.invalid, 2U);
  EXPECT_EQ(said.network.skipped, 7U);
  EXPECT_EQ(said.network.took_us, 11U);
  EXPECT_EQ(said.network.latency_us, 13U);
  EXPECT_EQ(said.network.period_us, 17U);
  EXPECT_EQ(said.health & ruffini_HealthBit_HEALTH_NETWORK, 0U);
  std::copy_n("no such file", 12, network.problem.begin());
  network.state = NetworkState::kFailed;
  said = status();
  EXPECT_EQ(said.network.state, ruffini_NetworkState_NETWORK_STATE_FAILED);
  EXPECT_STREQ(said.network.problem, "no such file");
  EXPECT_NE(said.health & ruffini_HealthBit_HEALTH_NETWORK, 0U);
}

TEST_F(SessionTest, StatusCarriesTheTemperatureWhereThereIsOne) {
  EXPECT_EQ(status().temperatures_count, 0U);
  exchange_.milli_celsius = 23'450;
  const ruffini_Status warm = status();
  ASSERT_EQ(warm.temperatures_count, 1U);
  EXPECT_STREQ(warm.temperatures[0].place, "gel");
  EXPECT_EQ(warm.temperatures[0].milli_celsius, 23'450);
}

// A host that asks and does not read: the newest questions are not answered, nothing grows, and the host can see that.
TEST_F(SessionTest, OfRepliesThatNobodyReadsOnlySoManyAreKeptAndTheOthersAreMissing) {
  for (int i = 0; i < 200; ++i) session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  const auto kept = read_all();
  ASSERT_EQ(kept.size(), 64U);
  EXPECT_EQ(status().drops.link_ring_full, 136U);
  const auto next = ask(ruffini_MessageType_MESSAGE_TYPE_HELLO);
  ASSERT_EQ(next.size(), 1U) << "and then it goes on";
  EXPECT_EQ(next[0].header.sequence, 201U) << "a number for each message, sent or not, and one for STATUS";
}

TEST_F(SessionTest, AFrameThatWasBegunIsFinishedBeforeANewerOne) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(100, 1));
  session_.poll(1);
  ASSERT_EQ(session_.pending().size(), 100U);
  session_.consumed(40);
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(50, 2));
  session_.poll(2);
  EXPECT_EQ(session_.pending().size(), 60U);
  session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  const std::span<const uint8_t> rest = session_.pending();
  ASSERT_EQ(rest.size(), 60U);
  EXPECT_EQ(rest[0], 1);
}

// Whoever comes next must not get the end of a frame whose begin somebody else has read.
TEST_F(SessionTest, ALineThatHungUpForgetsItsHalfFrame) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(100, 1));
  session_.poll(1);
  (void)session_.pending();
  session_.consumed(40);
  session_.reset_line();
  EXPECT_TRUE(session_.pending().empty());
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(50, 2));
  session_.poll(2);
  EXPECT_EQ(session_.pending().size(), 50U);
}

// A line that takes nothing for a while: what is offered is chosen again until its first byte went out.
TEST_F(SessionTest, ALineThatWasFullFindsTheNewestAndRepliesFirst) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {1, 1});
  session_.poll(1);
  EXPECT_EQ(session_.pending()[0], 1);
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {2, 2});
  session_.poll(2);
  EXPECT_EQ(session_.pending()[0], 2);
  EXPECT_EQ(exchange_.telemetry_dropped, 1U);
  session_.consumed(1);
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {3});
  session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  session_.poll(3);
  EXPECT_EQ(session_.pending()[0], 2) << "a message that was begun is finished";
  session_.consumed(1);
  EXPECT_GT(session_.pending().size(), 100U) << "then the reply";
  session_.consumed(session_.pending().size());
  EXPECT_EQ(session_.pending()[0], 3);
}

}  // namespace
}  // namespace ruffini
