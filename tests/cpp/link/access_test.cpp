// Two hosts, keys, replays: who may change something.
#include "link/access.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>

#include "support/install.h"
#include "support/owner_key.h"
#include "support/session_fixture.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::host_frame;

class AccessTest : public testing::Test {
 protected:
  ~AccessTest() override { std::filesystem::remove_all(folder_); }
  Status check(const Bytes& command, uint32_t counter, uint8_t sensor, const Bytes& signature) {
    clock_.us += Access::kFailureUs;  // the limit on failures is another test's
    return access_.check(command, counter, sensor, signature);
  }

  const std::string folder_ = testing::TempDir() + "access_test" + std::to_string(::getpid());
  test::FakeClock clock_;
  test::FakeRandom random_;
  test::OwnerKey owner_;
  KeyRing keys_ = owner_.enrolled_in(folder_);
  Access access_{keys_, "0042", {clock_, random_, false}};
};

TEST_F(AccessTest, OneHostAtATimeUntilItIsSilentForTwoSeconds) {
  ASSERT_TRUE(access_.acquire(1));
  access_.set_holder_name(1, "first host");
  clock_.us += Access::kLeaseUs;
  const Status refused = access_.acquire(2);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kBusy);
  EXPECT_NE(refused.error().message.find("for 2 s (first host): wait"), std::string::npos) << refused.error().message;
  EXPECT_FALSE(access_.acquire(0)) << "nor a host that knows no lease";
  EXPECT_TRUE(access_.acquire(1));
  clock_.us += Access::kLeaseUs;
  access_.renew(2);
  access_.renew(1);
  clock_.us += Access::kLeaseUs;
  EXPECT_FALSE(access_.is_free_for(2));
  clock_.us += 1;
  EXPECT_EQ(access_.holder(), "");
  ASSERT_TRUE(access_.acquire(2));
  EXPECT_EQ(access_.holder(), "it does not say who it is") << "not the name of the one before";
  access_.renew(1);
  EXPECT_FALSE(access_.acquire(1));
}

TEST_F(AccessTest, ALeaseEndsWhenItIsGivenBackOrTheLineHangsUp) {
  ASSERT_TRUE(access_.acquire(1));
  access_.release(2);
  EXPECT_FALSE(access_.acquire(2)) << "not its own to give back";
  access_.release(1);
  ASSERT_TRUE(access_.acquire(2));
  access_.reset();
  EXPECT_TRUE(access_.acquire(1));
}

TEST_F(AccessTest, ACommandCountsOnceUnderItsChallenge) {
  const Bytes command = {1, 2, 3};
  EXPECT_EQ(check(command, 1, 0, Bytes(64)).error().kind, ErrorKind::kUnavailable) << "no challenge yet";
  const Access::Nonce nonce = access_.challenge();
  const auto sign = [&](uint32_t counter) { return owner_.sign_command("0042", nonce, counter, 0, command); };
  EXPECT_TRUE(check(command, 1, 0, sign(1)));
  EXPECT_FALSE(check(command, 1, 0, sign(1))) << "again";
  EXPECT_TRUE(check(command, 5, 0, sign(5)));
  EXPECT_FALSE(check(command, 4, 0, sign(4))) << "late";
  EXPECT_FALSE(check(command, 0, 0, sign(0)));
  EXPECT_EQ(access_.n_refused(), 3U);
  const Access::Nonce next = access_.challenge();
  EXPECT_NE(nonce, next);
  EXPECT_FALSE(check(command, 6, 0, sign(6))) << "of the challenge before";
  EXPECT_TRUE(check(command, 1, 0, owner_.sign_command("0042", next, 1, 0, command)));
  access_.reset();
  EXPECT_EQ(check(command, 2, 0, owner_.sign_command("0042", next, 2, 0, command)).error().kind,
            ErrorKind::kUnavailable);
}

// Each bit of all that is signed, and of the signature.
TEST_F(AccessTest, EverySingleBitThatIsChangedIsRefused) {
  const Access::Nonce nonce = access_.challenge();
  Bytes command = {8, 9, 26, 2, 8, 5};
  Bytes signature = owner_.sign_command("0042", nonce, 3, 7, command);
  int n_bits = 0;
  const auto refuses = [&](uint32_t counter, uint8_t sensor) {
    ++n_bits;
    return !check(command, counter, sensor, signature);
  };
  for (Bytes* part : {&command, &signature}) {
    for (size_t bit = 0; bit < 8 * part->size(); ++bit) {
      (*part)[bit / 8] ^= static_cast<uint8_t>(1U << bit % 8);
      EXPECT_TRUE(refuses(3, 7)) << bit;
      (*part)[bit / 8] ^= static_cast<uint8_t>(1U << bit % 8);
    }
  }
  for (uint32_t bit = 0; bit < 32; ++bit) EXPECT_TRUE(refuses(3U ^ 1U << bit, 7)) << bit;
  for (uint32_t bit = 0; bit < 8; ++bit) EXPECT_TRUE(refuses(3, static_cast<uint8_t>(7U ^ 1U << bit))) << bit;
  EXPECT_FALSE(check(command, 3, 7, Bytes(signature.begin(), signature.end() - 1)));
  EXPECT_FALSE(check(command, 3, 7, {}));
  EXPECT_FALSE(check(command, 3, 7, owner_.sign_command("0043", nonce, 3, 7, command))) << "made for another sensor";
  EXPECT_FALSE(check(command, 3, 7, test::OwnerKey(8).sign_command("0042", nonce, 3, 7, command))) << "a stranger";
  EXPECT_TRUE(check(command, 3, 7, signature));
  EXPECT_EQ(n_bits, 48 + 512 + 32 + 8);
}

TEST_F(AccessTest, AHolderNamesItselfAloneAndKeepsItsNameOverAPause) {
  access_.set_holder_name(0, "nobody");
  ASSERT_TRUE(access_.acquire(1));
  access_.set_holder_name(1, "first host");
  access_.set_holder_name(0, "nobody");
  access_.set_holder_name(2, "second host");
  EXPECT_EQ(access_.holder(), "first host");
  clock_.us += Access::kLeaseUs + 1;
  EXPECT_EQ(access_.holder(), "");
  ASSERT_TRUE(access_.acquire(1));
  EXPECT_EQ(access_.holder(), "first host");
}

TEST_F(AccessTest, FiveWrongSignaturesAMinuteAndNoMoreIsLookedAt) {
  const Access::Nonce nonce = access_.challenge();
  const Bytes command = {1};
  const Bytes right = owner_.sign_command("0042", nonce, 1, 0, command);
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(access_.check(command, 1, 0, Bytes(64)).error().kind, ErrorKind::kRefused);
    clock_.us += 1'000'000;
  }
  EXPECT_EQ(access_.check(command, 1, 0, right).error().kind, ErrorKind::kBusy);
  clock_.us += Access::kFailureUs - 5'000'001;
  EXPECT_EQ(access_.check(command, 1, 0, right).error().kind, ErrorKind::kBusy);
  clock_.us += 1;
  EXPECT_TRUE(access_.check(command, 1, 0, right));
}

// The same at the line.
class SessionAccess : public test::SessionTest {
 protected:
  using test::SessionTest::command;
  ruffini_Command zero_by(uint32_t holder, uint32_t id) {
    ruffini_Command zero = request(id, ruffini_Command_zero_tag);
    zero.action.zero.n_frames = id;
    zero.holder = holder;
    return zero;
  }
};

TEST_F(SessionAccess, TheSecondHostIsToldWhoHasTheSensorAndReadsAllTheSame) {
  ruffini_Command lease = request(1, ruffini_Command_lease_tag);
  lease.holder = 10;
  std::snprintf(lease.action.lease.who, sizeof lease.action.lease.who, "cal flash of bench\n");
  ASSERT_EQ(command(lease).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_STREQ(status().access.holder, "cal flash of bench?");
  const ruffini_Reply busy = command(zero_by(20, 2));
  EXPECT_EQ(busy.code, ruffini_ReplyCode_REPLY_BUSY);
  EXPECT_NE(std::string(busy.text).find("(cal flash of bench?): wait for its end"), std::string::npos) << busy.text;
  EXPECT_EQ(command(zero_by(0, 3)).code, ruffini_ReplyCode_REPLY_BUSY);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  ruffini_Command challenge = request(4, ruffini_Command_challenge_tag);
  challenge.holder = 20;
  EXPECT_EQ(command(challenge).code, ruffini_ReplyCode_REPLY_BUSY) << "it would make the first host's void";
  ruffini_Command subscribe = request(5, ruffini_Command_subscribe_tag);
  subscribe.holder = 20;
  EXPECT_EQ(command(subscribe).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(command(zero_by(10, 6)).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.exchange(-1), 6);
  // What the second host asks does not make the first one's retry run again.
  EXPECT_EQ(command(subscribe).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(command(zero_by(20, 6)).code, ruffini_ReplyCode_REPLY_BUSY) << "the same id of another host";
  ask(ruffini_MessageType_MESSAGE_TYPE_HELLO);
  EXPECT_EQ(command(zero_by(10, 6)).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  lease.request_id = 7;
  lease.action.lease.release = true;
  EXPECT_EQ(command(lease).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(command(zero_by(20, 8)).code, ruffini_ReplyCode_REPLY_OK);
  session_.reset_line();
  EXPECT_EQ(command(zero_by(10, 9)).code, ruffini_ReplyCode_REPLY_OK) << "the line hung up";
}

class OwnedSession : public SessionAccess {
 protected:
  OwnedSession()
      : owned_(board_, "0042", SlotStore::open(folder_).value(), exchange_, TrialRule(),
               owner_.enrolled_in(folder_ + "_keys")),
        guarded_(board_, *path_, {.serial = "0042", .version = "test"}, owned_, exchange_, {clock_, random_, false}) {}
  ~OwnedSession() override { std::filesystem::remove_all(folder_ + "_keys"); }

  ruffini_Reply plainly(const ruffini_Command& command) {
    return reply_to(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(command)));
  }
  ruffini_Reply reply_to(const Bytes& frame) {
    guarded_.receive(frame);
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_TRUE(take(guarded_, ruffini_Reply_fields, &reply));
    return reply;
  }
  Bytes challenge(uint32_t id) {
    const ruffini_Reply reply = plainly(request(id, ruffini_Command_challenge_tag));
    EXPECT_EQ(reply.nonce.size, Access::kNonceBytes);
    return {reply.nonce.bytes, reply.nonce.bytes + reply.nonce.size};
  }
  Bytes signed_frame(const Bytes& nonce, uint32_t counter, const ruffini_Command& command) {
    const Bytes inner = encoded(command);
    const Bytes signature = owner_.sign_command("0042", nonce, counter, kDeviceSensor, inner);
    ruffini_SignedCommand outer = ruffini_SignedCommand_init_zero;
    outer.command.size = static_cast<pb_size_t>(inner.size());
    std::copy(inner.begin(), inner.end(), outer.command.bytes);
    outer.counter = counter;
    outer.signature.size = static_cast<pb_size_t>(signature.size());
    std::copy(signature.begin(), signature.end(), outer.signature.bytes);
    Bytes payload(ruffini_SignedCommand_size);
    pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
    EXPECT_TRUE(pb_encode(&stream, ruffini_SignedCommand_fields, &outer));
    payload.resize(stream.bytes_written);
    return host_frame(ruffini_MessageType_MESSAGE_TYPE_SIGNED_COMMAND, payload);
  }

  test::OwnerKey owner_;
  Calibrator owned_;
  Session guarded_;
};

TEST_F(OwnedSession, WhatChangesSomethingNeedsAnOwnersSignatureAndWhatReadsNeedsNone) {
  ruffini_Hello hello = ruffini_Hello_init_zero;
  guarded_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  ASSERT_TRUE(take(guarded_, ruffini_Hello_fields, &hello));
  EXPECT_TRUE(hello.needs_key);
  ASSERT_EQ(hello.key_ids_count, 1);
  EXPECT_EQ(hello.key_ids[0], owned_.keys().enrolled_ids().at(0));
  uint32_t id = 1;
  for (const int action :
       {ruffini_Command_zero_tag, ruffini_Command_set_tag, ruffini_Command_flash_begin_tag,
        ruffini_Command_flash_chunk_tag, ruffini_Command_flash_commit_tag, ruffini_Command_flash_abort_tag,
        ruffini_Command_flash_undo_tag, ruffini_Command_lease_tag}) {
    const ruffini_Reply reply = plainly(request(id++, static_cast<pb_size_t>(action)));
    EXPECT_EQ(reply.code, ruffini_ReplyCode_REPLY_REFUSED) << action;
    EXPECT_NE(std::string(reply.text).find("for its owners only"), std::string::npos) << reply.text;
  }
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  EXPECT_EQ(plainly(request(id++, ruffini_Command_subscribe_tag)).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(plainly(request(id++, ruffini_Command_flash_query_tag)).code, ruffini_ReplyCode_REPLY_REFUSED);
  const Bytes nonce = challenge(id++);
  EXPECT_EQ(reply_to(signed_frame(nonce, 1, zero_by(5, id++))).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.exchange(-1), static_cast<int>(id - 1));
}

// All that a host sent yesterday, byte for byte, on the same line today.
TEST_F(OwnedSession, ARecordedSessionThatIsPlayedAgainDoesNothing) {
  std::vector<Bytes> recorded;
  const Bytes nonce = challenge(1);
  recorded.push_back(
      host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(request(1, ruffini_Command_challenge_tag))));
  for (uint32_t i = 1; i <= 3; ++i) recorded.push_back(signed_frame(nonce, i, zero_by(5, 10 + i)));
  for (size_t i = 1; i < recorded.size(); ++i) EXPECT_EQ(reply_to(recorded[i]).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.exchange(-1), 13);
  // A retry is answered again, and does nothing; an older command is refused.
  EXPECT_EQ(reply_to(recorded[3]).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(reply_to(recorded[2]).code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  guarded_.reset_line();
  for (size_t i = 1; i < recorded.size(); ++i) {
    EXPECT_EQ(reply_to(recorded[i]).code, ruffini_ReplyCode_REPLY_NOT_READY) << "without its challenge";
  }
  for (size_t i = 0; i < recorded.size(); ++i) {
    const ruffini_Reply reply = reply_to(recorded[i]);
    EXPECT_EQ(reply.code, i == 0 ? ruffini_ReplyCode_REPLY_OK : ruffini_ReplyCode_REPLY_REFUSED) << i;
  }
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
}

TEST_F(SessionAccess, TheCalibrationInForceIsReadBackPieceByPiece) {
  const BoardSettings board = test::round_board();
  const Bytes file = test::sign(test::diagonal_calibration(board));
  const std::string sum = sha256(file);
  {
    SlotStore store = SlotStore::open(folder_).value();
    ASSERT_TRUE(test::install(store, file));
  }
  Calibrator calibrator(board, "0042", SlotStore::open(folder_).value(), exchange_);
  std::string problem;
  const auto path = calibrator.start([] { return uint64_t{0}; }, problem).value();
  Session session(board, *path, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
  const auto read = [&](const std::string& sha256, uint64_t offset) {
    ruffini_Command wanted = request(static_cast<uint32_t>(offset) + 1, ruffini_Command_flash_read_tag);
    wanted.action.flash_read.offset = offset;
    wanted.action.flash_read.sha256.size = static_cast<pb_size_t>(sha256.size());
    std::copy(sha256.begin(), sha256.end(), wanted.action.flash_read.sha256.bytes);
    session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(wanted)));
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_TRUE(take(session, ruffini_Reply_fields, &reply));
    return reply;
  };
  Bytes got;
  for (int i = 0; i < 10'000 && got.size() < file.size(); ++i) {
    const ruffini_Reply reply = read(sum, got.size());
    ASSERT_EQ(reply.code, ruffini_ReplyCode_REPLY_OK) << reply.text;
    ASSERT_GT(reply.data.size, 0);
    got.insert(got.end(), reply.data.bytes, reply.data.bytes + reply.data.size);
    EXPECT_EQ(reply.next_offset, got.size());
    EXPECT_EQ(reply.value, static_cast<int64_t>(file.size()));
  }
  EXPECT_EQ(got, file);
  EXPECT_EQ(read(sum, file.size()).data.size, 0);
  EXPECT_EQ(read(sum, file.size() + 1).code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_EQ(read(std::string(32, 'x'), 0).code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_EQ(read("", 0).code, ruffini_ReplyCode_REPLY_REFUSED);
}

TEST_F(SessionAccess, ATimeExchangeSaysWhenItCameAndWhenItWasAnswered) {
  clock_.us = 5'000'000;
  const auto answers = ask(ruffini_MessageType_MESSAGE_TYPE_TIME, {0x08, 0x96, 0x01});  // token 150
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].header.type, ruffini_MessageType_MESSAGE_TYPE_TIME);
  ruffini_Time time = ruffini_Time_init_zero;
  pb_istream_t in = pb_istream_from_buffer(answers[0].payload.data(), answers[0].payload.size());
  ASSERT_TRUE(pb_decode(&in, ruffini_Time_fields, &time));
  EXPECT_EQ(time.token, 150U);
  EXPECT_EQ(time.received_us, 5'000'000U);
  EXPECT_EQ(time.sent_us, 5'000'000U);
  EXPECT_TRUE(ask(ruffini_MessageType_MESSAGE_TYPE_TIME, {0xFF}).empty());
  EXPECT_EQ(status().drops.rx_malformed, 1U);
}

TEST_F(SessionAccess, WhatIsDroppedIsCountedByItsCause) {
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(100, 1));
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_WRENCH, Bytes(100, 2));
  push_telemetry(ruffini_MessageType_MESSAGE_TYPE_FIELD, Bytes(100, 3));
  session_.poll(5);
  exchange_.telemetry_dropped.fetch_add(1);  // the frame thread found the ring full
  ASSERT_EQ(session_.pending().size(), 100U);
  session_.consumed(40);
  session_.reset_line();  // within the wrench; the field waits
  const ruffini_Drops drops = status(6).drops;
  EXPECT_EQ(drops.link_backpressure, 2U);
  EXPECT_EQ(drops.link_replaced, 1U);
  EXPECT_EQ(drops.link_ring_full, 1U);
  EXPECT_EQ(drops.link_cut, 1U);
  EXPECT_EQ(drops.link_down, 1U);
}

}  // namespace
}  // namespace ruffini
