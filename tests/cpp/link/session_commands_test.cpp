// What a host commands: flash, undo, settings, zero, subscriptions; and how a device answers what makes no sense.
#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <memory>
#include <string>

#include "support/failing_medium.h"
#include "support/install.h"
#include "support/session_fixture.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::host_frame;

class SessionCommands : public test::SessionTest {};

TEST_F(SessionCommands, ZeroTakesSoManyFramesAndNoMore) {
  ruffini_Command zero = request(1, ruffini_Command_zero_tag);
  zero.action.zero.n_frames = 257;
  const ruffini_Reply refused = command(zero);
  EXPECT_EQ(refused.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_STREQ(refused.text, "zero takes 0 to 256 frames");
  EXPECT_EQ(exchange_.zero_frames.load(), kNoZeroRequest);
  zero.request_id = 2;
  zero.action.zero.n_frames = 256;
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), 256);
}

TEST_F(SessionCommands, OneSettingCanBeReadAndNoneWritten) {
  exchange_.frames_processed = 77;
  ruffini_Command get = request(1, ruffini_Command_get_tag);
  std::strcpy(get.action.get.key, "frames_processed");
  const ruffini_Reply got = command(get);
  EXPECT_EQ(got.code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(got.value, 77);
  ruffini_Command set = request(2, ruffini_Command_set_tag);
  std::strcpy(set.action.set.key, "frames_processed");
  const ruffini_Reply refused = command(set);
  EXPECT_EQ(refused.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_STREQ(refused.text, "no setting \"frames_processed\": this firmware has frames_processed (get)");
}

// All its fields are zeros, which protobuf writes as no byte at all.
TEST_F(SessionCommands, AReplyThatSaysNothingIsSentAllTheSame) {
  const ruffini_Reply reply = command(request(0, ruffini_Command_zero_tag));
  EXPECT_EQ(reply.code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), 0);
}

TEST_F(SessionCommands, ALeaseNeedsAHolder) {
  const ruffini_Reply refused = command(request(1, ruffini_Command_lease_tag));
  EXPECT_EQ(refused.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_STREQ(refused.text, "a lease needs a holder's number above 0");
  EXPECT_STREQ(status().access.holder, "");
}

TEST_F(SessionCommands, AnUploadThatIsGivenUpIsForgotten) {
  ruffini_Command begin = request(1, ruffini_Command_flash_begin_tag);
  begin.action.flash_begin.size_bytes = 10;
  begin.action.flash_begin.sha256.size = 32;
  EXPECT_EQ(command(begin).flash_state, ruffini_FlashState_FLASH_STATE_RECEIVING);
  ruffini_Command chunk = request(2, ruffini_Command_flash_chunk_tag);
  chunk.action.flash_chunk.data.size = 4;
  EXPECT_EQ(command(chunk).next_offset, 4U);
  const ruffini_Reply given_up = command(request(3, ruffini_Command_flash_abort_tag));
  EXPECT_EQ(given_up.code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(given_up.flash_state, ruffini_FlashState_FLASH_STATE_IDLE);
  EXPECT_EQ(given_up.next_offset, 0U);
  begin.request_id = 4;
  EXPECT_EQ(command(begin).next_offset, 0U) << "not resumed";
}

// Without anything in force there is nothing to read back, to undo or to ask after, not even by the hash of nothing.
TEST_F(SessionCommands, WhereNothingIsInForceNothingIsSaidToBe) {
  const ruffini_Reply read = command(request(1, ruffini_Command_flash_read_tag));
  EXPECT_EQ(read.code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_EQ(read.data.size, 0);
  const ruffini_Reply asked = command(request(2, ruffini_Command_flash_query_tag));
  EXPECT_EQ(asked.code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_STREQ(asked.text, "this calibration is not in force");
  const ruffini_Reply undone = command(request(3, ruffini_Command_flash_undo_tag));
  EXPECT_EQ(undone.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_NE(std::string(undone.text).find("no calibration was in force before"), std::string::npos);
}

// One file in force, another before it.
TEST_F(SessionCommands, UndoIsActiveAtOnceAndAQueryIsOfTheWholeHash) {
  const BoardSettings board = test::round_board();
  const Bytes before = test::sign(test::diagonal_calibration(board));
  const Bytes now = test::sign(test::diagonal_calibration(board, true));
  {
    SlotStore store = SlotStore::open(folder_).value();
    ASSERT_TRUE(test::install(store, before));
    ASSERT_TRUE(test::install(store, now));
  }
  Calibrator calibrator(board, "0042", SlotStore::open(folder_).value(), exchange_);
  std::string problem;
  const auto path = calibrator.start([] { return uint64_t{0}; }, problem).value();
  Session session(board, *path, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
  const auto reply_to = [&](const ruffini_Command& wanted) {
    session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(wanted)));
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_TRUE(take(session, ruffini_Reply_fields, &reply));
    return reply;
  };
  uint32_t id = 0;
  const auto query = [&](const std::string& hash) {
    ruffini_Command wanted = request(++id, ruffini_Command_flash_query_tag);
    wanted.action.flash_query.sha256.size = static_cast<pb_size_t>(hash.size());
    std::copy(hash.begin(), hash.end(), wanted.action.flash_query.sha256.bytes);
    return reply_to(wanted);
  };
  EXPECT_EQ(query(sha256(now)).flash_state, ruffini_FlashState_FLASH_STATE_ACTIVE);
  EXPECT_EQ(query(sha256(before)).code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_EQ(query(sha256(now).substr(0, 31)).code, ruffini_ReplyCode_REPLY_REFUSED);
  const ruffini_Reply undone = reply_to(request(++id, ruffini_Command_flash_undo_tag));
  EXPECT_EQ(undone.code, ruffini_ReplyCode_REPLY_OK) << undone.text;
  EXPECT_EQ(undone.flash_state, ruffini_FlashState_FLASH_STATE_ACTIVE);
  EXPECT_EQ(query(sha256(before)).flash_state, ruffini_FlashState_FLASH_STATE_ACTIVE);
  EXPECT_EQ(query(sha256(now)).code, ruffini_ReplyCode_REPLY_REFUSED);
  delete exchange_.next_path.exchange(nullptr);
}

// The medium failed just when the trial ended; the device tries again each second.
TEST_F(SessionCommands, WhatAPowerCutMayUndoIsNotSaidToBeDone) {
  const BoardSettings board = test::round_board();
  const Bytes file = test::sign(test::diagonal_calibration(board));
  auto made = std::make_unique<test::FailingMedium>();
  test::FailingMedium& medium = *made;
  Calibrator calibrator(board, "0042", SlotStore::open(std::move(made)), exchange_);
  std::string problem;
  const auto path = calibrator.start([] { return uint64_t{0}; }, problem).value();
  Session session(board, *path, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
  ASSERT_TRUE(calibrator.begin(file.size(), sha256(file)));
  ASSERT_TRUE(calibrator.chunk(0, file));
  ASSERT_TRUE(calibrator.commit());
  exchange_.tally = PathTally{exchange_.next_path.load()->calibration_id(), 32, 32};
  uint32_t id = 0;
  const auto query = [&] {
    ruffini_Command wanted = request(++id, ruffini_Command_flash_query_tag);
    wanted.action.flash_query.sha256.size = 32;
    const std::string hash = sha256(file);
    std::copy(hash.begin(), hash.end(), wanted.action.flash_query.sha256.bytes);
    session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(wanted)));
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_TRUE(take(session, ruffini_Reply_fields, &reply));
    return reply;
  };
  medium.fails = test::FailingMedium::after(test::Call::kSyncFolder);
  session.poll(10'000'000);
  ruffini_Event event = ruffini_Event_init_zero;
  ASSERT_TRUE(take(session, ruffini_Event_fields, &event));
  EXPECT_STREQ(event.what, "calibration_active");
  EXPECT_EQ(event.severity, ruffini_Event_Severity_SEVERITY_ERROR);
  const ruffini_Reply failed = query();
  EXPECT_EQ(failed.code, ruffini_ReplyCode_REPLY_STORAGE);
  EXPECT_EQ(failed.flash_state, ruffini_FlashState_FLASH_STATE_ACTIVE);
  EXPECT_NE(std::string(failed.text).find("may not be so after a power cut"), std::string::npos) << failed.text;
  medium.fails = [](test::Call, const std::string&) { return false; };
  session.poll(11'000'000);
  ASSERT_TRUE(take(session, ruffini_Event_fields, &event));
  EXPECT_STREQ(event.what, "calibration_active");
  EXPECT_EQ(event.severity, ruffini_Event_Severity_SEVERITY_INFO);
  const ruffini_Reply done = query();
  EXPECT_EQ(done.code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_STREQ(done.text, "");
  delete exchange_.next_path.exchange(nullptr);
}

// Neither the outer message nor what it holds: nothing is run, nothing answered, both are counted.
TEST_F(SessionCommands, ASignedCommandThatIsNoneIsCounted) {
  EXPECT_TRUE(ask(ruffini_MessageType_MESSAGE_TYPE_SIGNED_COMMAND, {0xFF}).empty());
  EXPECT_TRUE(ask(ruffini_MessageType_MESSAGE_TYPE_SIGNED_COMMAND, {0x0A, 0x01, 0xFF}).empty()) << "command: one byte";
  EXPECT_EQ(status().drops.rx_malformed, 2U);
  EXPECT_EQ(status().access.n_refused, 0U);
}

TEST_F(SessionCommands, ASubscriptionToNoTypeIsNone) {
  ruffini_Command m = request(1, ruffini_Command_subscribe_tag);
  m.action.subscribe.subscriptions_count = 1;
  m.action.subscribe.subscriptions[0].every = 3;
  EXPECT_EQ(command(m).code, ruffini_ReplyCode_REPLY_OK);
  for (const auto& every : exchange_.every) EXPECT_EQ(every.load(), 0U);
}

TEST_F(SessionCommands, WhoSubscribesToStatusHasItOnceASecond) {
  ruffini_Command m = request(1, ruffini_Command_subscribe_tag);
  m.action.subscribe.subscriptions_count = 1;
  m.action.subscribe.subscriptions[0] = {ruffini_MessageType_MESSAGE_TYPE_STATUS, 1};
  ASSERT_EQ(command(m).code, ruffini_ReplyCode_REPLY_OK);
  std::vector<uint64_t> said_ms;
  for (uint64_t now_ms = 10; now_ms <= 3'000; now_ms += 10) {
    session_.poll(now_ms * 1'000);
    for (const Message& message : read_all()) {
      EXPECT_EQ(message.header.type, ruffini_MessageType_MESSAGE_TYPE_STATUS);
      said_ms.push_back(now_ms);
    }
  }
  EXPECT_EQ(said_ms, (std::vector<uint64_t>{10, 1'010, 2'010}));
}

// Types wait in slots of their own: what is older goes first, whatever its type.
TEST_F(SessionCommands, OfTwoTypesTheOlderGoesFirst) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_FIELD, {5});
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {4});
  session_.poll(1);
  for (const uint8_t wanted : Bytes{5, 4}) {
    ASSERT_EQ(session_.pending().size(), 1U);
    EXPECT_EQ(session_.pending()[0], wanted);
    session_.consumed(1);
  }
  EXPECT_TRUE(session_.is_drained());
}

// A line that takes nothing has begun nothing: the newest still wins.
TEST_F(SessionCommands, ALineThatTookNothingHasBegunNothing) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {1, 1});
  session_.poll(1);
  ASSERT_EQ(session_.pending().size(), 2U);
  session_.consumed(0);
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {2, 2});
  session_.poll(2);
  EXPECT_EQ(session_.pending()[0], 2);
  session_.reset_line();
  EXPECT_EQ(status().drops.link_cut, 0U);
}

// A recording in lockstep: nothing is replaced, the ring keeps what has to wait, in order.
TEST_F(SessionCommands, InLockstepNoTelemetryIsLost) {
  Session session(board_, *path_, {.serial = "0042", .version = "test", .is_lossless = true}, calibrator_, exchange_,
                  {clock_, random_});
  for (uint8_t i = 1; i <= 5; ++i) push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, {i});
  Bytes sent;
  for (uint64_t now = 1; now <= 20; ++now) {
    session.poll(now);
    session.poll(now);  // before anything was written: its slot is taken
    if (session.pending().empty()) break;
    sent.push_back(session.pending()[0]);
    session.consumed(session.pending().size());
  }
  EXPECT_EQ(sent, (Bytes{1, 2, 3, 4, 5}));
  EXPECT_EQ(exchange_.telemetry_dropped.load(), 0U);
  EXPECT_TRUE(session.is_drained());
}

}  // namespace
}  // namespace ruffini
