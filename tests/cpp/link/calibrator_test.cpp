#include "link/calibrator.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "support/install.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

uint64_t still_clock() { return 0; }

class CalibratorTest : public testing::Test {
 protected:
  CalibratorTest()
      : folder_(testing::TempDir() + "calibrator_test" + std::to_string(::getpid())),
        file_(test::sign(test::diagonal_calibration(board_))),
        calibrator_(open()) {
    std::string problem;
    EXPECT_TRUE(calibrator_.start(still_clock, problem)) << problem;
    EXPECT_EQ(problem, "");
  }
  ~CalibratorTest() override {
    delete exchange_.next_path.load();
    std::filesystem::remove_all(folder_);
  }

  Calibrator open(const std::string& serial = "0042") {
    return {board_, serial, SlotStore::open(folder_).value(), exchange_};
  }
  Status upload(const Bytes& file) { return upload(file, calibrator_); }
  static Status upload(const Bytes& file, Calibrator& on) {
    Status begun = on.begin(file.size(), sha256(file));
    if (!begun) return begun;
    const std::span<const uint8_t> all(file);
    for (size_t at = 0; at < file.size(); at += Calibrator::kMaxChunkBytes) {
      Status taken = on.chunk(at, all.subspan(at, std::min(Calibrator::kMaxChunkBytes, file.size() - at)));
      if (!taken) return taken;
    }
    return Unit{};
  }
  // The frame thread takes the new path over and computes frames with it.
  void show(uint16_t n_frames, uint16_t n_good, uint32_t wrong_flags = 0) {
    const FramePath* next = exchange_.next_path.load();
    ASSERT_NE(next, nullptr);
    exchange_.wrong_flags = wrong_flags;
    exchange_.tally = PathTally{next->calibration_id(), n_frames, n_good};
  }
  void flash(const Bytes& file) { flash(file, calibrator_); }
  void flash(const Bytes& file, Calibrator& on) {
    ASSERT_TRUE(upload(file, on));
    const Status committed = on.commit();
    ASSERT_TRUE(committed) << committed.error().message;
    show(32, 32);
    const auto end = on.poll();
    ASSERT_TRUE(end.has_value());
    ASSERT_TRUE(end->is_confirmed) << end->text;
  }
  // The same, made a year later.
  [[nodiscard]] Bytes newer() const {
    Bytes out = file_;
    const std::string year = "2026-11-21";
    const auto at = std::search(out.begin(), out.end(), year.begin(), year.end());
    EXPECT_NE(at, out.end());
    at[3] = '7';
    return test::sign(std::move(out));
  }
  // The same of another version and security epoch, one digit each.
  [[nodiscard]] Bytes stamped(const std::string& version, const std::string& epoch) const {
    Bytes out = file_;
    for (const auto& [key, digit] : {std::pair<std::string, std::string>{"\"version\":\"", version},
                                     std::pair<std::string, std::string>{"\"security_epoch\":\"", epoch}}) {
      const auto at = std::search(out.begin(), out.end(), key.begin(), key.end());
      EXPECT_NE(at, out.end());
      at[static_cast<std::ptrdiff_t>(key.size())] = static_cast<uint8_t>(digit[0]);
    }
    return test::sign(std::move(out));
  }
  // What a start now makes of the store.
  [[nodiscard]] std::string in_force_after_a_restart() {
    Calibrator later = open();
    std::string problem;
    EXPECT_TRUE(later.start(still_clock, problem));
    return later.active().sha256;
  }
  // What commit() says against the file; nothing of it may be in force.
  Error refusal_of(const Bytes& file) {
    EXPECT_TRUE(upload(file));
    const Status committed = calibrator_.commit();
    EXPECT_FALSE(committed);
    EXPECT_EQ(exchange_.next_path.load(), nullptr);
    EXPECT_FALSE(calibrator_.active().is_present);
    EXPECT_FALSE(calibrator_.is_receiving());
    EXPECT_FALSE(std::filesystem::exists(folder_ + "/calibration-1.safetensors"));
    return committed ? Error{} : committed.error();
  }

  BoardSettings board_ = test::round_board();
  std::string folder_;
  Exchange exchange_;
  Bytes file_;
  Calibrator calibrator_;
};

TEST_F(CalibratorTest, WhatWasUploadedIsInForceNowAndAfterARestart) {
  flash(file_);
  const std::string hash = sha256(file_);
  EXPECT_EQ(calibrator_.active().sha256, hash);
  EXPECT_EQ(calibrator_.active().kinds, "operator,support,photometric");
  EXPECT_TRUE(calibrator_.active().signer.is_development_key);
  EXPECT_FALSE(calibrator_.is_receiving());
  ASSERT_NE(exchange_.next_path.load(), nullptr);
  const uint32_t id = exchange_.next_path.load()->calibration_id();
  EXPECT_EQ(id >> 24, static_cast<uint8_t>(hash[0]));
  EXPECT_EQ(id & 0xFF, static_cast<uint8_t>(hash[3]));

  Calibrator later = open();
  std::string problem;
  auto path = later.start(still_clock, problem);
  ASSERT_TRUE(path);
  EXPECT_EQ(problem, "");
  EXPECT_EQ(later.active().sha256, hash);
  EXPECT_EQ(path.value()->calibration_id(), id);
}

TEST_F(CalibratorTest, UndoPutsBackWhatWasInForceAndUndoesItself) {
  const Status nothing = calibrator_.undo();
  ASSERT_FALSE(nothing);
  EXPECT_NE(nothing.error().message.find("no calibration was in force before"), std::string::npos);
  const Bytes newer = this->newer();
  ASSERT_NE(sha256(newer), sha256(file_));
  flash(file_);
  EXPECT_FALSE(calibrator_.undo());
  flash(newer);
  for (const Bytes& wanted : {file_, newer, file_}) {
    const Status undone = calibrator_.undo();
    ASSERT_TRUE(undone) << undone.error().message;
    EXPECT_EQ(calibrator_.active().sha256, sha256(wanted));
    EXPECT_EQ(exchange_.next_path.load()->calibration_id() & 0xFF, static_cast<uint8_t>(sha256(wanted)[3]));
    EXPECT_EQ(in_force_after_a_restart(), sha256(wanted));
  }
}

// Until good frames were seen, the frames are computed with the new file, and a restart goes back.
TEST_F(CalibratorTest, ANewCalibrationIsOnTrialUntilItHasShownGoodFrames) {
  flash(file_);
  const Bytes newer = this->newer();
  ASSERT_TRUE(upload(newer));
  ASSERT_TRUE(calibrator_.commit());
  EXPECT_TRUE(calibrator_.is_on_trial());
  EXPECT_EQ(calibrator_.active().sha256, sha256(newer));
  EXPECT_FALSE(calibrator_.poll()) << "no frame yet";
  show(255, 31);
  EXPECT_FALSE(calibrator_.poll());
  EXPECT_EQ(calibrator_.tally().n_good, 31);
  exchange_.tally = PathTally{0x12345678, 255, 255};
  EXPECT_FALSE(calibrator_.poll()) << "these were frames of another path";
  show(255, 32);
  const auto end = calibrator_.poll();
  ASSERT_TRUE(end.has_value());
  EXPECT_TRUE(end->is_confirmed);
  EXPECT_FALSE(calibrator_.is_on_trial());
  EXPECT_FALSE(calibrator_.poll()) << "said once";
  EXPECT_EQ(calibrator_.problem(), "");
  EXPECT_EQ(in_force_after_a_restart(), sha256(newer));
}

TEST_F(CalibratorTest, ARestartDuringTheTrialGoesBackAndSaysSo) {
  flash(file_);
  ASSERT_TRUE(upload(newer()));
  ASSERT_TRUE(calibrator_.commit());
  Calibrator later = open();
  std::string problem;
  ASSERT_TRUE(later.start(still_clock, problem));
  EXPECT_EQ(later.active().sha256, sha256(file_));
  EXPECT_NE(problem.find("on trial when the power went"), std::string::npos) << problem;
}

TEST_F(CalibratorTest, ATrialWithoutGoodFramesGoesBackAndSaysWhy) {
  const Bytes newer = this->newer();
  for (const bool has_before : {false, true}) {
    if (has_before) flash(file_);
    ASSERT_TRUE(upload(newer));
    ASSERT_TRUE(calibrator_.commit());
    show(256, 3, kFlagDark | kFlagMarkersLost);
    const auto end = calibrator_.poll();
    ASSERT_TRUE(end.has_value());
    EXPECT_FALSE(end->is_confirmed);
    EXPECT_NE(end->text.find("3 of 256 frames were good (markers lost, dark)"), std::string::npos) << end->text;
    EXPECT_EQ(calibrator_.problem(), end->text);
    EXPECT_EQ(calibrator_.active().sha256, has_before ? sha256(file_) : "");
    EXPECT_EQ(exchange_.next_path.load()->calibration_id() != 0, has_before);
    EXPECT_EQ(in_force_after_a_restart(), has_before ? sha256(file_) : "");
  }
  flash(newer);
  EXPECT_EQ(calibrator_.problem(), "") << "the next flash went well";
}

TEST_F(CalibratorTest, UndoEndsATrialAndASecondFlashWaitsForItsEnd) {
  flash(file_);
  ASSERT_TRUE(upload(newer()));
  ASSERT_TRUE(calibrator_.commit());
  ASSERT_TRUE(upload(newer()));
  const Status second = calibrator_.commit();
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kUnavailable);
  ASSERT_TRUE(calibrator_.undo());
  EXPECT_FALSE(calibrator_.is_on_trial());
  EXPECT_EQ(calibrator_.active().sha256, sha256(file_));
  EXPECT_EQ(in_force_after_a_restart(), sha256(file_));
}

TEST_F(CalibratorTest, ARecordingHasNoTrial) {
  Calibrator once(board_, "0042", SlotStore::open(folder_).value(), exchange_, TrialRule{0, 0});
  std::string problem;
  ASSERT_TRUE(once.start(still_clock, problem));
  ASSERT_TRUE(once.begin(file_.size(), sha256(file_)));
  ASSERT_TRUE(once.chunk(0, file_));
  ASSERT_TRUE(once.commit());
  EXPECT_FALSE(once.is_on_trial());
  EXPECT_EQ(in_force_after_a_restart(), sha256(file_));
}

TEST_F(CalibratorTest, AStoredFileThatDoesNotFitIsNamedAndNotUsed) {
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, Bytes(100, 7)));
  Calibrator later = open();
  std::string problem;
  auto path = later.start(still_clock, problem);
  ASSERT_TRUE(path);
  EXPECT_NE(problem, "");
  EXPECT_FALSE(later.active().is_present);
  EXPECT_EQ(path.value()->calibration_id(), 0U);
}

// The medium lost the file in force (or somebody put another one there): what was calibrated before still measures.
TEST_F(CalibratorTest, WhereTheFileInForceIsSpoiltTheOneBeforeItIs) {
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, file_));
  ASSERT_TRUE(test::install(store, Bytes(100, 7)));
  Calibrator later = open();
  std::string problem;
  auto path = later.start(still_clock, problem);
  ASSERT_TRUE(path);
  EXPECT_EQ(later.active().sha256, sha256(file_));
  EXPECT_NE(path.value()->calibration_id(), 0U);
  EXPECT_NE(problem.find("the one before it is in force"), std::string::npos) << problem;
}

// What measured while the newest file was spoilt is what an undo must find: the next flash deletes the spoilt one.
TEST_F(CalibratorTest, AFlashKeepsTheFileInForceAndNotTheSpoiltOneBesideIt) {
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, file_));
  for (const Bytes& spoilt : {Bytes(), Bytes(100, 7)}) {
    ASSERT_TRUE(test::install(store, newer()));
    std::ofstream(folder_ + "/calibration-2.safetensors", std::ios::binary | std::ios::trunc)
        .write(reinterpret_cast<const char*>(spoilt.data()), static_cast<std::streamsize>(spoilt.size()));
    Calibrator later = open();
    std::string problem;
    ASSERT_TRUE(later.start(still_clock, problem));
    EXPECT_NE(problem.find("the one before it is in force"), std::string::npos) << problem;
    EXPECT_EQ(later.active().sha256, sha256(file_));
    const Status nothing_before = later.undo();
    ASSERT_FALSE(nothing_before);
    EXPECT_NE(nothing_before.error().message.find("no calibration was in force before"), std::string::npos);
    flash(newer(), later);
    EXPECT_EQ(later.active().sha256, sha256(newer()));
    EXPECT_FALSE(std::filesystem::exists(folder_ + "/calibration-2.safetensors"));
    ASSERT_TRUE(later.undo());
    EXPECT_EQ(later.active().sha256, sha256(file_));
    EXPECT_EQ(in_force_after_a_restart(), sha256(file_));
    std::filesystem::remove_all(folder_);
    store = SlotStore::open(folder_).value();
    ASSERT_TRUE(test::install(store, file_));
  }
}

// Power went after the rename that put a file in force, before the spoilt one beside it was deleted.
TEST_F(CalibratorTest, AnUndoPassesOverASpoiltFile) {
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, file_));
  std::filesystem::copy(folder_ + "/calibration-1.safetensors", folder_ + "/kept");
  ASSERT_TRUE(test::install(store, newer()));
  ASSERT_TRUE(test::install(store, newer()));
  std::filesystem::rename(folder_ + "/kept", folder_ + "/calibration-1.safetensors");
  std::ofstream(folder_ + "/calibration-2.safetensors", std::ios::trunc);
  Calibrator later = open();
  std::string problem;
  ASSERT_TRUE(later.start(still_clock, problem));
  EXPECT_EQ(later.active().sha256, sha256(newer()));
  const Status undone = later.undo();
  ASSERT_TRUE(undone) << undone.error().message;
  EXPECT_EQ(later.active().sha256, sha256(file_));
  EXPECT_EQ(in_force_after_a_restart(), sha256(file_));
}

TEST_F(CalibratorTest, WhereNothingStoredCanBeUsedTheFactorysIs) {
  Calibrator first = open();
  first.set_factory(file_);
  std::string problem;
  ASSERT_TRUE(first.start(still_clock, problem));
  EXPECT_EQ(first.active().sha256, sha256(file_));
  EXPECT_EQ(problem, "") << "nothing was ever flashed";
  SlotStore store = SlotStore::open(folder_).value();
  ASSERT_TRUE(test::install(store, Bytes(100, 7)));
  ASSERT_TRUE(test::install(store, Bytes(100, 8)));
  Calibrator later = open();
  later.set_factory(file_);
  ASSERT_TRUE(later.start(still_clock, problem));
  EXPECT_EQ(later.active().sha256, sha256(file_));
  EXPECT_NE(problem.find("the factory's is in force"), std::string::npos) << problem;
}

TEST_F(CalibratorTest, AnOlderVersionIsRefusedAndUndoGoesBackToIt) {
  flash(stamped("5", "0"));
  const Bytes older = stamped("4", "0");
  ASSERT_TRUE(upload(older));
  const Status refused = calibrator_.commit();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kRefused);
  EXPECT_NE(refused.error().message.find("version 4, version 5 is in force"), std::string::npos)
      << refused.error().message;
  EXPECT_FALSE(calibrator_.is_receiving());
  flash(stamped("6", "0"));
  ASSERT_TRUE(calibrator_.undo());
  EXPECT_EQ(calibrator_.active().manifest.version, 5);
}

// The epoch rises when the trial has ended well, not before, and holds whatever is undone or spoilt.
TEST_F(CalibratorTest, ASecurityEpochIsReachedWithTheConfirmationAndNeverLeft) {
  flash(stamped("1", "0"));
  ASSERT_TRUE(upload(stamped("2", "3")));
  ASSERT_TRUE(calibrator_.commit());
  ASSERT_TRUE(calibrator_.undo()) << "ends the trial";
  flash(stamped("3", "0"));
  flash(stamped("4", "3"));
  const Status undone = calibrator_.undo();
  ASSERT_FALSE(undone) << "what was before is of epoch 0";
  EXPECT_EQ(undone.error().kind, ErrorKind::kRefused);
  EXPECT_NE(undone.error().message.find("epoch 0, this device is at 3"), std::string::npos) << undone.error().message;
  ASSERT_TRUE(upload(stamped("5", "2")));
  EXPECT_FALSE(calibrator_.commit());
  {
    SlotStore store = SlotStore::open(folder_).value();  // the file in force is spoilt
    ASSERT_TRUE(test::install(store, Bytes(100, 7)));
    ASSERT_TRUE(test::install(store, stamped("3", "0")));
  }
  Calibrator later = open();
  std::string problem;
  ASSERT_TRUE(later.start(still_clock, problem));
  EXPECT_FALSE(later.active().is_present);
  EXPECT_NE(problem.find("does not go back"), std::string::npos) << problem;
  flash(stamped("6", "3"));
}

TEST_F(CalibratorTest, OneSpoiltByteOfTheUploadIsSeen) {
  ASSERT_TRUE(calibrator_.begin(file_.size(), sha256(file_)));
  Bytes spoilt = file_;
  spoilt[spoilt.size() / 2] ^= 1;
  ASSERT_TRUE(calibrator_.chunk(0, spoilt));
  const Status committed = calibrator_.commit();
  ASSERT_FALSE(committed);
  EXPECT_EQ(committed.error().kind, ErrorKind::kStorage);
  EXPECT_FALSE(calibrator_.active().is_present);
}

TEST_F(CalibratorTest, OneSpoiltByteBeforeTheHashWasTakenFailsTheSignature) {
  Bytes spoilt = file_;
  spoilt[spoilt.size() - 100] ^= 1;
  const Error error = refusal_of(spoilt);
  EXPECT_EQ(error.kind, ErrorKind::kRefused);
  EXPECT_NE(error.message.find("signature"), std::string::npos) << error.message;
}

TEST_F(CalibratorTest, AFileWhoseVersionIsNoNumberIsRefused) {
  const Error error = refusal_of(stamped("x", "0"));
  EXPECT_EQ(error.kind, ErrorKind::kBadInput);
  EXPECT_NE(error.message.find("version = \"x\""), std::string::npos) << error.message;
}

TEST_F(CalibratorTest, AFileForAnotherBoardIsRefused) {
  BoardSettings other = board_;
  other.name = "other";
  const Error error = refusal_of(test::sign(test::diagonal_calibration(other)));
  EXPECT_EQ(error.kind, ErrorKind::kRefused);
  EXPECT_NE(error.message.find("\"other\""), std::string::npos) << error.message;
}

TEST_F(CalibratorTest, AFileForAnotherGridIsRefused) {
  BoardSettings other = board_;
  other.grid = {9, 7};
  EXPECT_EQ(refusal_of(test::sign(test::diagonal_calibration(other))).kind, ErrorKind::kBadInput);
}

// As many nodes, but 13 x 17 of them: force would be given to the wrong places.
TEST_F(CalibratorTest, AFileForTheSameNumberOfNodesInAnotherGridIsRefused) {
  BoardSettings other = board_;
  std::swap(other.grid.n_x, other.grid.n_y);
  const Error error = refusal_of(test::sign(test::diagonal_calibration(other)));
  EXPECT_EQ(error.kind, ErrorKind::kBadInput);
  EXPECT_NE(error.message.find("operator.n_x"), std::string::npos) << error.message;
}

TEST_F(CalibratorTest, AnOperatorOfOtherStepsIsRefused) {
  for (const std::string key : {"operator.displacement_lsb_nm", "operator.force_lsb_un"}) {
    Bytes other = file_;
    const std::string text = "\"" + key + "\":\"1";
    const auto at = std::search(other.begin(), other.end(), text.begin(), text.end());
    ASSERT_NE(at, other.end()) << key;
    at[static_cast<ptrdiff_t>(text.size()) - 1] = '2';
    const Error error = refusal_of(test::sign(other));
    EXPECT_EQ(error.kind, ErrorKind::kBadInput);
    EXPECT_NE(error.message.find(key), std::string::npos) << error.message;
  }
}

TEST_F(CalibratorTest, ChunksAreTakenInOrderAndNoFurtherThanAnnounced) {
  EXPECT_FALSE(calibrator_.chunk(0, Bytes{1})) << "nothing was begun";
  ASSERT_TRUE(calibrator_.begin(4, sha256(Bytes{1, 2, 3, 4})));
  EXPECT_FALSE(calibrator_.chunk(1, Bytes{2}));
  EXPECT_FALSE(calibrator_.chunk(0, Bytes{}));
  EXPECT_FALSE(calibrator_.chunk(0, Bytes(5)));
  EXPECT_TRUE(calibrator_.chunk(0, Bytes{1, 2, 3}));
  EXPECT_FALSE(calibrator_.chunk(0, Bytes{1}));
  EXPECT_EQ(calibrator_.next_offset(), 3U);
  EXPECT_FALSE(calibrator_.commit()) << "a byte is missing";
  EXPECT_TRUE(calibrator_.is_receiving()) << "and can still come";
}

TEST_F(CalibratorTest, TheSameHashResumesAndAnotherStartsAnew) {
  ASSERT_TRUE(calibrator_.begin(4, sha256(Bytes{1, 2, 3, 4})));
  ASSERT_TRUE(calibrator_.chunk(0, Bytes{1, 2}));
  ASSERT_TRUE(calibrator_.begin(4, sha256(Bytes{1, 2, 3, 4})));
  EXPECT_EQ(calibrator_.next_offset(), 2U);
  ASSERT_TRUE(calibrator_.begin(5, sha256(Bytes{1, 2, 3, 4}))) << "another file, whatever its hash";
  EXPECT_EQ(calibrator_.next_offset(), 0U);
  ASSERT_TRUE(calibrator_.chunk(0, Bytes{1, 2}));
  ASSERT_TRUE(calibrator_.begin(5, sha256(Bytes{4, 3, 2, 1})));
  EXPECT_EQ(calibrator_.next_offset(), 0U);
}

TEST_F(CalibratorTest, SizesThatNoFileHasAreRefusedAtOnce) {
  const std::string hash(32, 'x');
  EXPECT_FALSE(calibrator_.begin(0, hash));
  EXPECT_FALSE(calibrator_.begin(Calibrator::kMaxUploadBytes + 1, hash));
  EXPECT_FALSE(calibrator_.begin(10, hash.substr(1)));
  EXPECT_FALSE(calibrator_.is_receiving());
}

}  // namespace
}  // namespace ruffini
