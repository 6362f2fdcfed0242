// HELLO, SCHEMA and STATUS at their limits: lists that do not fit, keys of an owner, faults of link and camera.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <string>

#include "link/proto_text.h"
#include "schema.h"
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

class SessionSays : public test::SessionTest {
 protected:
  ~SessionSays() override { std::filesystem::remove_all(keys_folder_); }

  ruffini_Hello hello_of(Session& session) {
    session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO));
    ruffini_Hello hello = ruffini_Hello_init_zero;
    EXPECT_TRUE(take(session, ruffini_Hello_fields, &hello));
    return hello;
  }
  ruffini_Status status_of(Session& session) {
    session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_STATUS));
    session.poll(5);
    ruffini_Status status = ruffini_Status_init_zero;
    EXPECT_TRUE(take(session, ruffini_Status_fields, &status));
    return status;
  }
  // A calibrator with this file in force.
  Calibrator with(const BoardSettings& board, const Bytes& file, const KeyRing& keys = KeyRing()) {
    SlotStore store = SlotStore::open(folder_).value();
    EXPECT_TRUE(test::install(store, file));
    Calibrator calibrator(board, "0042", SlotStore::open(folder_).value(), exchange_, TrialRule(), keys);
    std::string problem;
    path_ = calibrator.start([] { return uint64_t{0}; }, problem).value();
    EXPECT_EQ(problem, "");
    return calibrator;
  }
  const DeviceIdentity identity_{.serial = "0042", .version = "test"};
  const std::string keys_folder_ = folder_ + "_keys";
};

// A host's decoder refuses a message with a string that is no UTF-8.
TEST(ProtoText, OnlyWholeUtf8CharactersAreSaid) {
  const auto said = [](const std::string& text) {
    char out[8] = "xxxxxxx";
    copy_text(out, text);
    return std::string(out);
  };
  EXPECT_EQ(said("a\xC3\xA9\xE2\x82\xAC"), "a\xC3\xA9\xE2\x82\xAC");
  EXPECT_EQ(said("\xF0\x9F\x98\x80"), "\xF0\x9F\x98\x80");
  EXPECT_EQ(said("abcdef\xC3\xA9"), "abcdef") << "half a character does not fit";
  EXPECT_EQ(said("abcdefghi"), "abcdefg");
  EXPECT_EQ(said("a\xFFz"), "a?z");
  EXPECT_EQ(said("a\xC3"), "a?") << "cut off";
  EXPECT_EQ(said("\xC3z"), "?z");
  EXPECT_EQ(said("\xC0\xAF"), "??") << "overlong";
  EXPECT_EQ(said("\xE0\x9F\xBF"), "???") << "overlong";
  EXPECT_EQ(said("\xF0\x8F\xBF\xBF"), "????") << "overlong";
  EXPECT_EQ(said("\xED\xA0\x80"), "???") << "a surrogate";
  EXPECT_EQ(said("\xED\x9F\xBF"), "\xED\x9F\xBF");
  EXPECT_EQ(said("\xF4\x90\x80\x80"), "????") << "beyond U+10FFFF";
  EXPECT_EQ(said("\xF4\x8F\xBF\xBF"), "\xF4\x8F\xBF\xBF");
  EXPECT_EQ(said("\xF8\x80"), "??");
}

TEST_F(SessionSays, TheSchemaThatItSpeaks) {
  const auto answers = ask(ruffini_MessageType_MESSAGE_TYPE_SCHEMA);
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].header.type, ruffini_MessageType_MESSAGE_TYPE_SCHEMA);
  const Bytes schema(kSchemaBytes, kSchemaBytes + kSchemaSize);
  const Bytes& payload = answers[0].payload;
  EXPECT_NE(std::search(payload.begin(), payload.end(), schema.begin(), schema.end()), payload.end());
  const std::string hash = sha256(schema);
  EXPECT_EQ(std::memcmp(hash.data(), kSchemaSha256, sizeof kSchemaSha256), 0);
  EXPECT_NE(std::search(payload.begin(), payload.end(), std::begin(kSchemaSha256), std::end(kSchemaSha256)),
            payload.end());
}

TEST_F(SessionSays, HelloNamesWhatIsNotMeasured) {
  board_.not_measured = {"torque", "shear"};
  Session session(board_, *path_, identity_, calibrator_, exchange_, {clock_, random_});
  const ruffini_Hello hello = hello_of(session);
  ASSERT_EQ(hello.sensors[0].not_measured_count, 2);
  EXPECT_STREQ(hello.sensors[0].not_measured[0], "torque");
  EXPECT_STREQ(hello.sensors[0].not_measured[1], "shear");
}

// More keys than HELLO has room for: those that fit, and all of them count.
TEST_F(SessionSays, HelloNamesAsManyKeysAsFit) {
  KeyRing keys;
  for (uint8_t i = 1; i <= 9; ++i) {
    keys = test::OwnerKey(i).enrolled_in(keys_folder_);
    std::filesystem::rename(keys_folder_ + "/owner.pub", keys_folder_ + "/" + std::to_string(i) + ".pub");
  }
  ASSERT_EQ(keys.enrolled_ids().size(), 9U);
  Calibrator calibrator(board_, "0042", SlotStore::open(folder_).value(), exchange_, TrialRule(), keys);
  Session session(board_, *path_, identity_, calibrator, exchange_, {clock_, random_});
  const ruffini_Hello hello = hello_of(session);
  ASSERT_EQ(hello.key_ids_count, 8);
  for (size_t i = 0; i < 8; ++i) EXPECT_EQ(hello.key_ids[i], keys.enrolled_ids()[i]);
}

// A file may say a kind as often as it likes.
TEST_F(SessionSays, HelloNamesAsManyKindsAsFit) {
  const BoardSettings board = test::round_board();
  Bytes file = test::diagonal_calibration(board);
  std::string more;
  for (int i = 0; i < 20; ++i) more += "operator,";
  more += "support,";  // 188 bytes, and four blanks after the header: a multiple of 8
  const std::string kinds = "\"kinds\":\"";
  const auto at = std::search(file.begin(), file.end(), kinds.begin(), kinds.end());
  ASSERT_NE(at, file.end());
  uint64_t header_bytes = 0;
  std::memcpy(&header_bytes, file.data(), sizeof header_bytes);
  file.insert(file.begin() + 8 + static_cast<std::ptrdiff_t>(header_bytes), 4, ' ');
  file.insert(std::search(file.begin(), file.end(), kinds.begin(), kinds.end()) + 9, more.begin(), more.end());
  header_bytes += more.size() + 4;
  std::memcpy(file.data(), &header_bytes, sizeof header_bytes);
  Calibrator calibrator = with(board, test::sign(file));
  Session session(board, *path_, identity_, calibrator, exchange_, {clock_, random_});
  const ruffini_CalibrationInfo info = hello_of(session).sensors[0].calibration;
  ASSERT_EQ(info.kinds_count, std::size(info.kinds));
  for (const auto& kind : info.kinds) EXPECT_STREQ(kind, "operator");
}

TEST_F(SessionSays, AnOwnersFileIsNotOfTheDevelopmentKey) {
  const BoardSettings board = test::round_board();
  const test::OwnerKey owner;
  Bytes file = test::diagonal_calibration(board);
  const size_t n_signed = file.size() - crypto_sign_BYTES;
  const Bytes signature = owner.sign(std::span(file).first(n_signed));
  std::copy(signature.begin(), signature.end(), file.begin() + static_cast<std::ptrdiff_t>(n_signed));
  for (const bool is_owned : {false, true}) {
    const KeyRing keys = is_owned ? owner.enrolled_in(keys_folder_) : KeyRing();
    Calibrator calibrator = with(board, is_owned ? file : test::sign(file), keys);
    Session session(board, *path_, identity_, calibrator, exchange_, {clock_, random_});
    const ruffini_Status said = status_of(session);
    EXPECT_EQ(said.development_key, !is_owned);
    EXPECT_EQ((said.health & ruffini_HealthBit_HEALTH_DEVELOPMENT_KEY) != 0, !is_owned);
    EXPECT_EQ(hello_of(session).sensors[0].calibration.development_key, !is_owned);
  }
}

TEST_F(SessionSays, AnOrderlyLastRunIsNoFault) {
  DeviceIdentity identity = identity_;
  identity.last_run.emplace().uptime_us = 77;
  ASSERT_EQ(identity.last_run->end, RunEnd::kStopped);
  Session session(board_, *path_, identity, calibrator_, exchange_, {clock_, random_});
  const ruffini_Status said = status_of(session);
  ASSERT_TRUE(said.has_last_run);
  EXPECT_EQ(said.last_run.uptime_us, 77U);
  EXPECT_EQ(said.health & (ruffini_HealthBit_HEALTH_CRASHED | ruffini_HealthBit_HEALTH_SAFE_MODE), 0U);
}

TEST_F(SessionSays, StatusSaysThatRestIsNotLearnedYet) {
  EXPECT_FALSE(status().health & ruffini_HealthBit_HEALTH_NO_REFERENCE);
  exchange_.flags = kFlagNoReference | kFlagDark;
  EXPECT_TRUE(status().health & ruffini_HealthBit_HEALTH_NO_REFERENCE);
}

TEST_F(SessionSays, OneDamagedFrameIsADegradedLink) {
  EXPECT_FALSE(status().health & ruffini_HealthBit_HEALTH_LINK_DEGRADED);
  Bytes damaged = host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, Bytes(20, 7));
  damaged[20] ^= 1;  // of the payload
  session_.receive(damaged);
  const ruffini_Status said = status();
  EXPECT_TRUE(said.health & ruffini_HealthBit_HEALTH_LINK_DEGRADED);
  EXPECT_EQ(said.drops.rx_bad_crc, 1U);
}

// There is no wrench to repeat yet: that the camera gives nothing is said as an event.
TEST_F(SessionSays, ACameraThatNeverGaveAFrameHasNoLastWrench) {
  exchange_.is_camera_live = true;
  exchange_.every[ruffini_MessageType_MESSAGE_TYPE_WRENCH] = 1;
  session_.poll(1'000'000);
  session_.poll(1'000'000 + StallWatch::kFirstUs + 1);
  const auto said = read_all();
  ASSERT_EQ(said.size(), 1U);
  EXPECT_EQ(said[0].header.type, ruffini_MessageType_MESSAGE_TYPE_EVENT);
}

}  // namespace
}  // namespace ruffini
