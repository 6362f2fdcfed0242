// The calibrator on a medium whose calls fail: what is in force goes on, and what happened is said.
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "link/calibrator.h"
#include "support/failing_medium.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::Call;
using test::FailingMedium;

const std::string kFirst = "calibration-1.safetensors";
const std::string kSecond = "calibration-2.safetensors";
const std::string kTrial = "trial.safetensors";

class CalibratorFaults : public testing::Test {
 protected:
  ~CalibratorFaults() override { delete exchange_.next_path.load(); }

  // A device that starts on a medium with these files; `problem_` is what it says.
  Calibrator& start(test::Names names, const FailingMedium::Fails& fails = nothing) {
    auto made = std::make_unique<FailingMedium>(std::move(names));
    medium_ = made.get();
    medium_->fails = fails;
    calibrator_ = std::make_unique<Calibrator>(board_, "0042", SlotStore::open(std::move(made)), exchange_);
    EXPECT_TRUE(calibrator_->start([] { return uint64_t{0}; }, problem_));
    return *calibrator_;
  }
  Status commit(Calibrator& calibrator) {
    Status begun = calibrator.begin(file_.size(), sha256(file_));
    if (!begun) return begun;
    Status taken = calibrator.is_complete() ? Status(Unit{}) : calibrator.chunk(0, file_);
    if (!taken) return taken;
    return calibrator.commit();
  }
  // The frame thread takes the new path over and computes frames with it.
  void show(uint16_t n_frames, uint16_t n_good) {
    exchange_.tally = PathTally{exchange_.next_path.load()->calibration_id(), n_frames, n_good};
  }
  static bool nothing(Call, const std::string&) { return false; }

  BoardSettings board_ = test::round_board();
  Exchange exchange_;
  const Bytes file_ = test::sign(test::diagonal_calibration(board_));
  FailingMedium* medium_ = nullptr;
  std::unique_ptr<Calibrator> calibrator_;
  std::string problem_;
};

TEST_F(CalibratorFaults, AtTheStartEveryTroubleIsSaid) {
  start({{kFirst, test::kept(file_)}}, FailingMedium::after(Call::kCanWrite));
  EXPECT_TRUE(calibrator_->active().is_present);
  EXPECT_EQ(problem_, "can_write failed; what is in force goes on, nothing can be flashed");
  // A trial cut short, and nothing to go back to that could be used.
  start({{kFirst, test::kept(Bytes(100, 7))}, {kTrial, test::kept(file_)}}, FailingMedium::after(Call::kCanWrite));
  EXPECT_FALSE(calibrator_->active().is_present);
  EXPECT_EQ(problem_.find("stored calibration not used: "), 0U) << problem_;
  EXPECT_NE(problem_.find("; the last flash was on trial when the power went"), std::string::npos) << problem_;
  EXPECT_NE(problem_.find("; can_write failed"), std::string::npos) << problem_;
}

// A medium whose newest file cannot be read, and on which nothing can be written.
TEST_F(CalibratorFaults, WhatCanBeReadMeasuresAndAFlashIsRefused) {
  start({{kFirst, test::kept(file_)}, {kSecond, test::kept(file_)}}, [](Call call, const std::string& name) {
    return call == Call::kCanWrite || (call == Call::kRead && name == kSecond);
  });
  EXPECT_EQ(calibrator_->active().sha256, sha256(file_));
  EXPECT_NE(problem_.find("read failed; the one before it is in force; can_write failed"), std::string::npos)
      << problem_;
  const Status begun = calibrator_->begin(file_.size(), sha256(file_));
  ASSERT_FALSE(begun);
  EXPECT_EQ(begun.error().kind, ErrorKind::kStorage);
  EXPECT_NE(begun.error().message.find("nothing can be flashed"), std::string::npos) << begun.error().message;
}

// Which security epoch was reached can then not be known: no file is taken, and none that is in force is lost.
TEST_F(CalibratorFaults, WhereTheEpochCannotBeReadNothingIsFlashed) {
  for (const int n_good : {0, 1}) {  // for the file's own check; for that of what it follows
    Calibrator& calibrator = start({});
    medium_->fails = FailingMedium::after(Call::kList, "", n_good);
    const Status committed = commit(calibrator);
    ASSERT_FALSE(committed) << n_good;
    EXPECT_EQ(committed.error().message, "list failed");
    EXPECT_FALSE(calibrator.active().is_present);
    EXPECT_EQ(exchange_.next_path.load(), nullptr);
    medium_->fails = nothing;
    EXPECT_TRUE(commit(calibrator)) << "flashed again";
    delete exchange_.next_path.exchange(nullptr);
  }
}

// The upload is kept: a commit alone tries again.
TEST_F(CalibratorFaults, AFlashThatCannotBeStoredIsRefusedAndCanBeTriedAgain) {
  Calibrator& calibrator = start({{kFirst, test::kept(Bytes(100, 7))}});
  medium_->fails = FailingMedium::after(Call::kSync);
  const Status committed = commit(calibrator);
  ASSERT_FALSE(committed);
  EXPECT_EQ(committed.error().message, "sync failed");
  EXPECT_FALSE(calibrator.is_on_trial());
  EXPECT_EQ(exchange_.next_path.load(), nullptr);
  EXPECT_TRUE(calibrator.is_complete());
  medium_->fails = nothing;
  ASSERT_TRUE(calibrator.commit());
  EXPECT_TRUE(calibrator.is_on_trial());
}

// Without a trial to come the file is in force at once, or not at all.
TEST_F(CalibratorFaults, WithoutATrialWhatCannotBeConfirmedIsNotInForce) {
  auto made = std::make_unique<FailingMedium>();
  made->fails = FailingMedium::after(Call::kRename, kTrial);
  Calibrator calibrator(board_, "0042", SlotStore::open(std::move(made)), exchange_, TrialRule{0, 0});
  ASSERT_TRUE(calibrator.start([] { return uint64_t{0}; }, problem_));
  const Status committed = commit(calibrator);
  ASSERT_FALSE(committed);
  EXPECT_EQ(committed.error().message, "rename failed");
  EXPECT_FALSE(calibrator.active().is_present);
  EXPECT_EQ(exchange_.next_path.load(), nullptr);
}

// The medium fails just when the trial has gone well.
TEST_F(CalibratorFaults, ATrialThatCannotBeConfirmedGoesBackAndSaysWhy) {
  for (const bool is_renamed : {false, true}) {
    Calibrator& calibrator = start({});
    ASSERT_TRUE(commit(calibrator));
    show(32, 32);
    medium_->fails = is_renamed ? FailingMedium::after(Call::kSyncFolder) : FailingMedium::after(Call::kRename, kTrial);
    const auto end = calibrator.poll();
    ASSERT_TRUE(end.has_value());
    EXPECT_FALSE(end->is_confirmed);
    EXPECT_FALSE(calibrator.is_on_trial());
    EXPECT_EQ(calibrator.active().is_present, is_renamed);
    EXPECT_EQ(exchange_.next_path.load()->calibration_id() != 0, is_renamed);
    const char* said = is_renamed ? "may not be so after a power cut" : "rename failed; what was before";
    EXPECT_NE(end->text.find(said), std::string::npos) << end->text;
    EXPECT_EQ(end->is_in_force, is_renamed);
    EXPECT_EQ(calibrator.problem(), end->text);
  }
}

// The rename is seen, its sync has failed: a power cut may take it back until a later sync.
TEST_F(CalibratorFaults, ASyncThatFailedAtATrialsEndIsRepeated) {
  Calibrator& calibrator = start({});
  ASSERT_TRUE(commit(calibrator));
  show(32, 32);
  medium_->fails = FailingMedium::after(Call::kSyncFolder);
  ASSERT_TRUE(calibrator.poll().has_value());
  EXPECT_FALSE(calibrator.make_durable());
  EXPECT_FALSE(calibrator.is_durable());
  EXPECT_NE(calibrator.problem().find("may not be so after a power cut"), std::string::npos);
  EXPECT_EQ(medium_->names_after(0).count(kFirst), 0U);
  medium_->fails = nothing;
  EXPECT_TRUE(calibrator.make_durable());
  EXPECT_TRUE(calibrator.is_durable());
  EXPECT_EQ(calibrator.problem(), "");
  EXPECT_EQ(medium_->names_after(0).count(kFirst), 1U);
  EXPECT_FALSE(calibrator.poll().has_value());
}

// Nothing was renamed, and the trial cannot even be removed: a restart would remove it.
TEST_F(CalibratorFaults, WhereEveryCallFailsATrialIsNotInForce) {
  Calibrator& calibrator = start({{kFirst, test::kept(file_)}});
  ASSERT_TRUE(commit(calibrator));
  show(32, 32);
  medium_->fails = [](Call call, const std::string&) { return call == Call::kRename || call == Call::kRemove; };
  const auto end = calibrator.poll();
  ASSERT_TRUE(end.has_value());
  EXPECT_FALSE(end->is_in_force);
  EXPECT_NE(end->text.find("rename failed; what was before is in force again"), std::string::npos) << end->text;
  EXPECT_TRUE(calibrator.is_durable());
}

TEST_F(CalibratorFaults, ALaterFlashOrUndoMakesDurableWhatASyncHadNot) {
  for (const bool is_undo : {false, true}) {
    Calibrator& calibrator = start({{kFirst, test::kept(file_)}});
    ASSERT_TRUE(commit(calibrator));
    show(32, 32);
    medium_->fails = FailingMedium::after(Call::kSyncFolder);
    ASSERT_TRUE(calibrator.poll().has_value());
    ASSERT_FALSE(calibrator.is_durable());
    medium_->fails = nothing;
    EXPECT_TRUE(is_undo ? calibrator.undo() : commit(calibrator));
    EXPECT_TRUE(calibrator.is_durable());
    EXPECT_EQ(calibrator.problem(), "");
    EXPECT_EQ(medium_->names_after(0).count(is_undo ? "calibration-3.safetensors" : kSecond), 1U);
  }
}

// The medium may be as before the undo, or after it.
TEST_F(CalibratorFaults, AnUndoWhoseSyncFailsIsDurableOnlyAfterAnother) {
  for (const bool is_way_back : {true, false}) {
    Calibrator& calibrator = start({{kFirst, test::kept(file_)}, {kSecond, test::kept(file_)}});
    int n_renames = 0;
    medium_->fails = [&](Call call, const std::string&) {
      return call == Call::kSyncFolder || (call == Call::kRename && ++n_renames > 1 && !is_way_back);
    };
    EXPECT_EQ(static_cast<bool>(calibrator.undo()), !is_way_back);
    EXPECT_FALSE(calibrator.is_durable());
    EXPECT_NE(calibrator.problem().find("may not be so after a power cut"), std::string::npos);
    medium_->fails = nothing;
    EXPECT_TRUE(calibrator.make_durable());
    EXPECT_EQ(medium_->names_after(0).count("calibration-3.safetensors"), is_way_back ? 0U : 1U);
    EXPECT_EQ(calibrator.problem(), "");
  }
}

TEST_F(CalibratorFaults, AStartWhoseSyncFailsIsDurableOnlyAfterAnother) {
  Calibrator& calibrator = start({{kFirst, test::kept(file_)}}, FailingMedium::after(Call::kSyncFolder));
  EXPECT_TRUE(calibrator.active().is_present);
  EXPECT_FALSE(calibrator.is_durable());
  EXPECT_NE(problem_.find("may not be so after a power cut"), std::string::npos) << problem_;
  medium_->fails = nothing;
  EXPECT_TRUE(calibrator.make_durable());
  EXPECT_EQ(calibrator.problem(), "");
}

TEST_F(CalibratorFaults, ATrialThatEndsBadlySaysAlsoWhatIsWrongWithTheFileBefore) {
  Calibrator& calibrator = start({{kFirst, test::kept(Bytes(100, 7))}});
  ASSERT_TRUE(commit(calibrator));
  show(256, 0);
  const auto end = calibrator.poll();
  ASSERT_TRUE(end.has_value());
  EXPECT_NE(end->text.find("0 of 256 frames were good"), std::string::npos) << end->text;
  EXPECT_NE(end->text.find("flash again; stored calibration not used: "), std::string::npos) << end->text;
  EXPECT_FALSE(calibrator.active().is_present);
}

TEST_F(CalibratorFaults, AnUndoThatTheMediumFailsLeavesWhatIsInForce) {
  Calibrator& calibrator = start({{kFirst, test::kept(file_)}, {kSecond, test::kept(file_)}});
  for (const auto& [call, said] : {std::pair{Call::kRead, "read failed"}, {Call::kRename, "rename failed"}}) {
    medium_->fails = FailingMedium::after(call);
    const Status undone = calibrator.undo();
    ASSERT_FALSE(undone) << said;
    EXPECT_EQ(undone.error().message, said);
    EXPECT_EQ(calibrator.active().sha256, sha256(file_));
    EXPECT_EQ(exchange_.next_path.load(), nullptr) << said;
  }
  medium_->fails = nothing;
  EXPECT_TRUE(calibrator.undo());
  EXPECT_NE(exchange_.next_path.load(), nullptr);
}

// Frames of whatever path say nothing of a calibration where none is in force.
TEST_F(CalibratorFaults, WithoutACalibrationNoFrameCounts) {
  exchange_.tally = PathTally{0, 200, 200};
  const Calibrator& calibrator = start({});
  EXPECT_EQ(calibrator.tally().n_frames, 0);
  EXPECT_EQ(calibrator.tally().n_good, 0);
}

}  // namespace
}  // namespace ruffini
