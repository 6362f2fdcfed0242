// What the session says of the device's state: trials, damaged frames, a camera that stands still, an aged skin.
#include <gtest/gtest.h>

#include <cstring>
#include <string>

#include "link/stall_watch.h"
#include "support/install.h"
#include "support/session_fixture.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::host_frame;

class SessionHealth : public test::SessionTest {
 protected:
  void subscribe_to_wrenches() {
    ruffini_Command subscribe = request(1, ruffini_Command_subscribe_tag);
    subscribe.action.subscribe.subscriptions_count = 1;
    subscribe.action.subscribe.subscriptions[0] = {ruffini_MessageType_MESSAGE_TYPE_WRENCH, 1};
    command(subscribe);
  }
};

// DURABLE is on trial, ACTIVE is for good, and what is neither is refused with its reason.
TEST_F(SessionHealth, AFlashedFileIsDurableThenActiveOrGone) {
  const BoardSettings board = test::round_board();
  Calibrator calibrator(board, "0042", SlotStore::open(folder_).value(), exchange_);
  std::string problem;
  const auto path = calibrator.start([] { return uint64_t{0}; }, problem).value();
  Session session(board, *path, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
  const Bytes file = test::sign(test::diagonal_calibration(board));
  const std::string hash = sha256(file);
  uint32_t id = 0;
  const auto say = [&](ruffini_MessageType type, const pb_msgdesc_t* fields, void* message, const Bytes& payload) {
    if (type != ruffini_MessageType_MESSAGE_TYPE_EVENT) session.receive(host_frame(type, payload));
    session.poll(5);
    return take(session, fields, message);
  };
  const auto query = [&] {
    ruffini_Command m = request(++id, ruffini_Command_flash_query_tag);
    m.action.flash_query.sha256.size = 32;
    std::memcpy(m.action.flash_query.sha256.bytes, hash.data(), 32);
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_TRUE(say(ruffini_MessageType_MESSAGE_TYPE_COMMAND, ruffini_Reply_fields, &reply, encoded(m)));
    return reply;
  };
  const auto health = [&] {
    ruffini_Status m = ruffini_Status_init_zero;
    EXPECT_TRUE(say(ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_Status_fields, &m, {}));
    return m.health;
  };
  EXPECT_EQ(query().code, ruffini_ReplyCode_REPLY_REFUSED);
  for (const bool is_good : {false, true}) {
    ASSERT_TRUE(calibrator.begin(file.size(), hash));
    ASSERT_TRUE(calibrator.chunk(0, file));
    ASSERT_TRUE(calibrator.commit());
    const uint32_t calibration_id = exchange_.next_path.load()->calibration_id();
    exchange_.tally = PathTally{calibration_id, 20, 12};
    const ruffini_Reply durable = query();
    EXPECT_EQ(durable.flash_state, ruffini_FlashState_FLASH_STATE_DURABLE);
    EXPECT_EQ(durable.value, 20);
    EXPECT_STREQ(durable.text, "on trial: 12 of 32 good frames, of 20");
    EXPECT_EQ(health() & (ruffini_HealthBit_HEALTH_TRIAL | ruffini_HealthBit_HEALTH_STORE_ERROR),
              uint32_t{ruffini_HealthBit_HEALTH_TRIAL});
    ruffini_Hello hello = ruffini_Hello_init_zero;
    EXPECT_TRUE(say(ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_Hello_fields, &hello, {}));
    EXPECT_TRUE(hello.sensors[0].calibration.on_trial);

    exchange_.tally = PathTally{calibration_id, 256, static_cast<uint16_t>(is_good ? 256 : 0)};
    ruffini_Event event = ruffini_Event_init_zero;
    ASSERT_TRUE(say(ruffini_MessageType_MESSAGE_TYPE_EVENT, ruffini_Event_fields, &event, {}));
    EXPECT_STREQ(event.what, is_good ? "calibration_active" : "calibration_reverted");
    const ruffini_Reply end = query();
    EXPECT_EQ(end.code, is_good ? ruffini_ReplyCode_REPLY_OK : ruffini_ReplyCode_REPLY_REFUSED);
    EXPECT_EQ(end.flash_state == ruffini_FlashState_FLASH_STATE_ACTIVE, is_good);
    EXPECT_STREQ(end.text, is_good ? "" : event.text);
    EXPECT_EQ(health() & (ruffini_HealthBit_HEALTH_TRIAL | ruffini_HealthBit_HEALTH_STORE_ERROR),
              is_good ? 0U : uint32_t{ruffini_HealthBit_HEALTH_STORE_ERROR});
    hello = ruffini_Hello_init_zero;
    EXPECT_TRUE(say(ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_Hello_fields, &hello, {}));
    EXPECT_FALSE(hello.sensors[0].calibration.on_trial);
  }
  delete exchange_.next_path.exchange(nullptr);
}

// A host that uploads need not wait for its time; anybody else's garbage is not answered.
TEST_F(SessionHealth, ADamagedFrameIsAskedForAgainWhileAnUploadRuns) {
  Bytes damaged = host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(request(9, ruffini_Command_zero_tag)));
  damaged[damaged.size() / 2] ^= 1;
  session_.receive(damaged);
  EXPECT_TRUE(read_all().empty());
  ASSERT_TRUE(calibrator_.begin(10, std::string(32, 'x')));
  ASSERT_TRUE(calibrator_.chunk(0, Bytes{1, 2, 3}));
  session_.receive(damaged);
  ruffini_Reply reply = ruffini_Reply_init_zero;
  ASSERT_TRUE(take(session_, ruffini_Reply_fields, &reply));
  EXPECT_EQ(reply.request_id, 0U);
  EXPECT_EQ(reply.code, ruffini_ReplyCode_REPLY_BAD_ARGUMENT);
  EXPECT_EQ(reply.next_offset, 3U);
  // Once: on a line that echoes, what it says would come back damaged and be answered again.
  for (int i = 0; i < 10; ++i) session_.receive(damaged);
  EXPECT_TRUE(read_all().empty());
  command(request(10, ruffini_Command_get_tag));
  session_.receive(damaged);
  EXPECT_EQ(read_all().size(), 1U) << "a whole command came in between";
}

// No frame for a while: the last wrench comes again, marked and without a valid number; and that it is over is said.
TEST_F(SessionHealth, ACameraThatStandsStillIsSaidAndItsLastWrenchIsMarked) {
  exchange_.is_camera_live = true;
  exchange_.frames_processed = 10;
  exchange_.frames_captured = 10;
  exchange_.flags = kFlagWindowBorder;
  exchange_.last_frame.capture_us = 77;
  exchange_.last_frame.number = 9;
  exchange_.last_frame.calibration_id = 0xABCD;
  exchange_.last_frame.wrench_validity = 0x012011;  // x, y valid, z not measured, ...
  subscribe_to_wrenches();
  session_.poll(1'000'000);
  session_.poll(1'040'000);
  EXPECT_TRUE(read_all().empty()) << "the board's camera gives a frame each 16.7 ms";
  exchange_.frames_captured = 13;  // of another size: no good ones
  exchange_.frames_invalid = 3;
  session_.poll(1'060'000);
  auto said = read_all();
  session_.poll(1'062'000);
  EXPECT_TRUE(read_all().empty()) << "ten wrenches a second";
  session_.poll(1'160'000);
  for (auto& more : read_all()) said.push_back(more);
  ASSERT_EQ(said.size(), 3U) << "an event, and two wrenches";
  EXPECT_EQ(said[0].header.type, ruffini_MessageType_MESSAGE_TYPE_EVENT);
  ruffini_Wrench wrench = ruffini_Wrench_init_zero;
  for (const size_t i : {1U, 2U}) {
    ASSERT_EQ(said[i].header.type, ruffini_MessageType_MESSAGE_TYPE_WRENCH);
    pb_istream_t in = pb_istream_from_buffer(said[i].payload.data(), said[i].payload.size());
    ASSERT_TRUE(pb_decode(&in, ruffini_Wrench_fields, &wrench));
    EXPECT_EQ(wrench.stamp.flags, kFlagWindowBorder | uint32_t{ruffini_FlagBit_FLAG_STALE});
    EXPECT_EQ(wrench.stamp.capture_us, 77U);
    EXPECT_EQ(wrench.stamp.frame, 9U);
    EXPECT_EQ(wrench.stamp.calibration_id, 0xABCDU);
    for (size_t k = 0; k < 6; ++k) {
      const bool is_measured = (exchange_.last_frame.wrench_validity >> (4 * k) & 15) != 0;
      EXPECT_EQ(wrench.validity[k],
                is_measured ? ruffini_Validity_VALIDITY_INVALID : ruffini_Validity_VALIDITY_NOT_MEASURED);
    }
  }
  EXPECT_TRUE(status(1'162'000).health & ruffini_HealthBit_HEALTH_CAMERA_STALLED);
  exchange_.frames_processed = 11;
  session_.poll(1'170'000);
  ruffini_Event event = ruffini_Event_init_zero;
  ASSERT_TRUE(take(session_, ruffini_Event_fields, &event));
  EXPECT_STREQ(event.what, "camera_back");
  exchange_.is_camera_live = false;  // a recording that has ended is no fault
  session_.poll(9'000'000);
  EXPECT_TRUE(read_all().empty());
}

TEST_F(SessionHealth, AZeroThatAPressEndedIsSaidOnce) {
  exchange_.refused_zeros = 1;
  session_.poll(1'000'000);
  ruffini_Event event = ruffini_Event_init_zero;
  ASSERT_TRUE(take(session_, ruffini_Event_fields, &event));
  EXPECT_STREQ(event.what, "zero_refused");
  session_.poll(1'010'000);
  EXPECT_TRUE(read_all().empty());
  ruffini_Command zero = request(1, ruffini_Command_zero_tag);
  zero.action.zero.even_if_touched = true;
  EXPECT_EQ(command(zero).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_TRUE(exchange_.zero_even_if_touched);
  EXPECT_EQ(command(request(2, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_FALSE(exchange_.zero_even_if_touched);
}

// What is on the pad when frames come again, nobody has seen: a zero from before must not make it rest.
TEST_F(SessionHealth, AStallGivesAZeroUp) {
  exchange_.is_camera_live = true;
  exchange_.frames_processed = 10;
  session_.poll(1'000'000);
  const auto stall = [&](uint64_t now_us) {
    session_.poll(now_us);
    std::vector<std::string> events;
    for (const auto& message : read_all()) {
      ruffini_Event event = ruffini_Event_init_zero;
      pb_istream_t in = pb_istream_from_buffer(message.payload.data(), message.payload.size());
      EXPECT_TRUE(pb_decode(&in, ruffini_Event_fields, &event));
      events.emplace_back(event.what);
    }
    return events;
  };
  const auto frame = [&](uint64_t now_us) {
    ++exchange_.frames_processed;
    return stall(now_us);
  };
  using Events = std::vector<std::string>;
  ASSERT_EQ(command(request(1, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames, 0);
  EXPECT_EQ(stall(1'100'000), Events{"camera_stalled"});
  EXPECT_EQ(exchange_.zero_frames, 0) << "a hiccup: nobody's finger is that fast";
  EXPECT_EQ(stall(1'600'000), Events{"zero_given_up"}) << "asked for, not begun";
  EXPECT_EQ(stall(1'700'000), Events{}) << "said once";
  EXPECT_EQ(exchange_.zero_frames, kCancelZero);
  EXPECT_EQ(command(request(2, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_NOT_READY);
  EXPECT_EQ(exchange_.zero_frames, kCancelZero);
  EXPECT_EQ(frame(1'710'000), Events{"camera_back"});
  exchange_.zero_frames = kNoZeroRequest;  // taken by the frame thread
  EXPECT_EQ(stall(2'300'000), Events{"camera_stalled"}) << "nothing was being learned";
  EXPECT_EQ(frame(2'310'000), Events{"camera_back"});
  exchange_.is_zeroing = true;
  EXPECT_EQ(stall(2'900'000), (Events{"camera_stalled", "zero_given_up"})) << "in the middle of it";
  EXPECT_EQ(frame(2'910'000), Events{"camera_back"});
  EXPECT_EQ(command(request(3, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_OK);
}

// Wrenches of a stalled camera are telemetry: the newest waits, and no reply is lost for them.
// A camera at a sixth of its board's rate: rest can be learned between two of its frames once it is known.
TEST_F(SessionHealth, ASlowCameraStallsBeforeItsFirstFramesAndIsThenZeroed) {
  exchange_.is_camera_live = true;
  int n_stalls = 0;
  uint64_t now_us = 1'000'000;
  for (int frame = 0; frame < 20; ++frame) {
    ++exchange_.frames_processed;
    for (int k = 0; k < 20; ++k, now_us += 5'000) session_.poll(now_us);
    for (const auto& message : read_all()) {
      ruffini_Event event = ruffini_Event_init_zero;
      pb_istream_t in = pb_istream_from_buffer(message.payload.data(), message.payload.size());
      ASSERT_TRUE(pb_decode(&in, ruffini_Event_fields, &event));
      n_stalls += std::string(event.what) == "camera_stalled" ? 1 : 0;
    }
  }
  EXPECT_EQ(n_stalls, StallWatch::kMaxLateInARow);
  EXPECT_EQ(command(request(1, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_OK);
}

TEST_F(SessionHealth, AHostThatDoesNotReadLosesNoReplyToAStall) {
  exchange_.is_camera_live = true;
  exchange_.frames_processed = 10;
  subscribe_to_wrenches();
  session_.poll(1'000'000);
  for (uint64_t now = 1'100'000; now < 21'100'000; now += 100'000) session_.poll(now);
  session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
  const auto said = read_all();
  ASSERT_EQ(said.size(), 3U);
  EXPECT_EQ(said[0].header.type, ruffini_MessageType_MESSAGE_TYPE_EVENT);
  EXPECT_EQ(said[1].header.type, ruffini_MessageType_MESSAGE_TYPE_HELLO);
  EXPECT_EQ(said[2].header.type, ruffini_MessageType_MESSAGE_TYPE_WRENCH);
  EXPECT_EQ(exchange_.telemetry_dropped, 199U);
}

TEST_F(SessionHealth, StatusSaysWhatIsWrongWithCameraComputerCreepAndReflex) {
  const uint32_t usual = status(1'000'000).health;
  const auto adds = [&](uint32_t bit) { return (status(1'000'000).health & ~usual) == bit; };
  exchange_.frames_missed = 3;
  exchange_.frames_repeated = 4;
  exchange_.time_faults = 5;
  exchange_.zero_moved_nm = 6;
  exchange_.reflex_trips = 7;
  const ruffini_Status said = status(1'000'000);
  EXPECT_EQ(said.health, usual) << "counted, and no fault that lasts";
  EXPECT_EQ(said.camera_gaps, 3U);
  EXPECT_EQ(said.repeated_frames, 4U);
  EXPECT_EQ(said.time_faults, 5U);
  EXPECT_EQ(said.zero_moved_nm, 6U);
  EXPECT_EQ(said.reflex_trips, 7U);
  EXPECT_EQ(said.reflex, ruffini_ReflexState_REFLEX_STATE_NOT_ASKED);
  EXPECT_FALSE(said.has_last_run);
  exchange_.throttled = 0x50000;
  EXPECT_TRUE(adds(0)) << "was so once, and is over";
  EXPECT_EQ(status(1'000'000).throttled, 0x50000U);
  exchange_.throttled = 0x8;
  EXPECT_TRUE(adds(ruffini_HealthBit_HEALTH_THROTTLED));
  exchange_.throttled = 0;
  exchange_.has_light_fault = true;
  EXPECT_TRUE(adds(ruffini_HealthBit_HEALTH_LIGHT));
  exchange_.has_light_fault = false;
  exchange_.is_zero_at_limit = true;
  EXPECT_TRUE(adds(ruffini_HealthBit_HEALTH_ZERO_LIMIT));
  exchange_.is_zero_at_limit = false;
  for (const ReflexState state : {ReflexState::kOff, ReflexState::kOn}) {
    exchange_.reflex = state;
    EXPECT_TRUE(adds(0));
  }
  exchange_.reflex = ReflexState::kFailed;
  EXPECT_TRUE(adds(ruffini_HealthBit_HEALTH_REFLEX));
}

// A calibration that failed its own gates, or that nobody judged, measures something, and nobody knows how well.
TEST_F(SessionHealth, ACalibrationWithoutAReportThatPassedIsUnjudged) {
  const BoardSettings board = test::round_board();
  for (const std::string& gates : {std::string(), std::string("failed: normals"), std::string("passed")}) {
    const Bytes file = test::sign(test::diagonal_calibration(board, false, gates));
    Calibrator calibrator(board, "0042", SlotStore::open(folder_ + gates).value(), exchange_, TrialRule{0, 0});
    std::string problem;
    const auto path = calibrator.start([] { return uint64_t{0}; }, problem).value();
    Session session(board, *path, {.serial = "0042", .version = "test"}, calibrator, exchange_, {clock_, random_});
    const auto ask = [&](ruffini_MessageType type, const pb_msgdesc_t* fields, void* message) {
      session.receive(host_frame(type, {}));
      session.poll(5);
      ASSERT_TRUE(take(session, fields, message));
    };
    ruffini_Status status = ruffini_Status_init_zero;
    ask(ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_Status_fields, &status);
    EXPECT_EQ(status.health & ruffini_HealthBit_HEALTH_UNJUDGED, 0U) << "nothing is in force";
    ASSERT_TRUE(calibrator.begin(file.size(), sha256(file)));
    ASSERT_TRUE(calibrator.chunk(0, file));
    ASSERT_TRUE(calibrator.commit());
    ask(ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_Status_fields, &status);
    EXPECT_EQ((status.health & ruffini_HealthBit_HEALTH_UNJUDGED) == 0, gates == "passed") << gates;
    ruffini_Hello hello = ruffini_Hello_init_zero;
    ask(ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_Hello_fields, &hello);
    EXPECT_EQ(std::string(hello.sensors[0].calibration.summary), gates);
    delete exchange_.next_path.exchange(nullptr);
    std::filesystem::remove_all(folder_ + gates);
  }
}

// Under-voltage now: a power cut is near. That it once was is no reason, nor is heat.
TEST_F(SessionHealth, NoFlashIsBegunWhileThePowerIsShort) {
  ruffini_Command begin = request(1, ruffini_Command_flash_begin_tag);
  begin.action.flash_begin.size_bytes = 10;
  begin.action.flash_begin.sha256.size = 32;
  exchange_.throttled = 0x50001;
  const ruffini_Reply refused = command(begin);
  EXPECT_EQ(refused.code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_NE(std::string(refused.text).find("short of power (under-voltage)"), std::string::npos) << refused.text;
  EXPECT_FALSE(calibrator_.is_receiving());
  begin.request_id = 2;
  exchange_.throttled = 0x5000E;
  EXPECT_EQ(command(begin).flash_state, ruffini_FlashState_FLASH_STATE_RECEIVING);
}

// One frame in a hundred since the status before may be late.
TEST_F(SessionHealth, LateResultsAreCountedAndSaidWhereTheyAreMany) {
  exchange_.frames_processed = 1'000;
  exchange_.missed_deadlines = 10;
  EXPECT_FALSE(status(1'000'000).health & ruffini_HealthBit_HEALTH_LATE);
  exchange_.frames_processed = 1'100;
  exchange_.missed_deadlines = 12;
  const ruffini_Status late = status(2'000'000);
  EXPECT_TRUE(late.health & ruffini_HealthBit_HEALTH_LATE);
  EXPECT_EQ(late.missed_deadlines, 12U);
  exchange_.frames_processed = 1'200;
  EXPECT_FALSE(status(3'000'000).health & ruffini_HealthBit_HEALTH_LATE) << "and is over with them";
}

TEST_F(SessionHealth, TheLastRunAndSafeModeAreTold) {
  DeviceIdentity identity{.serial = "0042", .version = "test"};
  identity.last_run = LastRun{.end = RunEnd::kCrashed,
                              .signal = 6,
                              .thread = "frame",
                              .stuck = "capture",
                              .uptime_us = 77,
                              .calibration_id = "\x01\x02\x03\x04",
                              .crashes = 3};
  identity.is_safe_mode = true;
  Session session(board_, *path_, identity, calibrator_, exchange_, {clock_, random_});
  session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_STATUS));
  session.poll(5);
  ruffini_Status said = ruffini_Status_init_zero;
  ASSERT_TRUE(take(session, ruffini_Status_fields, &said));
  ASSERT_TRUE(said.has_last_run);
  EXPECT_EQ(said.last_run.end, ruffini_RunEnd_RUN_END_CRASHED);
  EXPECT_EQ(said.last_run.signal, 6U);
  EXPECT_STREQ(said.last_run.thread, "frame");
  EXPECT_STREQ(said.last_run.stuck, "capture");
  EXPECT_EQ(said.last_run.uptime_us, 77U);
  EXPECT_EQ(said.last_run.calibration_id.size, 4U);
  EXPECT_EQ(said.last_run.calibration_id.bytes[3], 4U);
  EXPECT_EQ(said.last_run.crashes, 3U);
  EXPECT_TRUE(said.health & ruffini_HealthBit_HEALTH_CRASHED);
  EXPECT_TRUE(said.health & ruffini_HealthBit_HEALTH_SAFE_MODE);
}

TEST_F(SessionHealth, ZeroIsRefusedWhileSomethingPressesUnlessItIsMeant) {
  exchange_.is_touched = true;
  const ruffini_Reply refused = command(request(1, ruffini_Command_zero_tag));
  EXPECT_EQ(refused.code, ruffini_ReplyCode_REPLY_REFUSED);
  EXPECT_NE(std::string(refused.text).find("presses on the pad"), std::string::npos);
  EXPECT_EQ(exchange_.zero_frames.load(), -1);
  ruffini_Command meant = request(2, ruffini_Command_zero_tag);
  meant.action.zero.n_frames = 5;
  meant.action.zero.even_if_touched = true;
  EXPECT_EQ(command(meant).code, ruffini_ReplyCode_REPLY_OK);
  EXPECT_EQ(exchange_.zero_frames.load(), 5);
  exchange_.is_touched = false;
  EXPECT_EQ(command(request(3, ruffini_Command_zero_tag)).code, ruffini_ReplyCode_REPLY_OK);
}

TEST_F(SessionHealth, StatusSaysHowFarASkinHasAged) {
  EXPECT_EQ(status().skin_light_1e3, 0U) << "no skin, nothing to say";
  EXPECT_FALSE(status().health & ruffini_HealthBit_HEALTH_SKIN_AGED);
  for (const auto& [light_1e3, has_aged] :
       {std::pair<uint32_t, bool>{751, false}, {749, true}, {1'249, false}, {1'251, true}}) {
    exchange_.skin_light_1e3 = light_1e3;
    const ruffini_Status said = status();
    EXPECT_EQ(said.skin_light_1e3, light_1e3);
    EXPECT_EQ((said.health & ruffini_HealthBit_HEALTH_SKIN_AGED) != 0, has_aged) << light_1e3;
  }
}

}  // namespace
}  // namespace ruffini
