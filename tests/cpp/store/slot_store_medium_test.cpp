// The store on a medium whose calls fail one by one: the error of the call is told, and what was in force stays so.
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "store/slot_store.h"
#include "support/failing_medium.h"
#include "support/install.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::Call;
using test::FailingMedium;

const std::string kFirst = "calibration-1.safetensors";
const std::string kSecond = "calibration-2.safetensors";

class SlotStoreMedium : public testing::Test {
 protected:
  // A store on a medium with these files, and a hold on that.
  SlotStore open(
      test::Names names, const FailingMedium::Fails& fails = [](Call, const std::string&) { return false; }) {
    auto made = std::make_unique<FailingMedium>(std::move(names));
    medium_ = made.get();
    medium_->fails = fails;
    return SlotStore::open(std::move(made));
  }
  static test::Names two() { return {{kFirst, test::kept(Bytes(10, 1))}, {kSecond, test::kept(Bytes(20, 2))}}; }
  void mend() {
    medium_->fails = [](Call, const std::string&) { return false; };
  }
  FailingMedium* medium_ = nullptr;
};

void expect_error(const Status& done, const std::string& said) {
  ASSERT_FALSE(done) << said;
  EXPECT_EQ(done.error().kind, ErrorKind::kStorage);
  EXPECT_EQ(done.error().message, said);
}

// Nobody can say then what is in force: every answer is the error, none is "nothing".
TEST_F(SlotStoreMedium, WhereTheFolderCannotBeListedEverythingSaysSo) {
  SlotStore store = open(two(), FailingMedium::after(Call::kList));
  EXPECT_EQ(store.problem(), "list failed");
  EXPECT_FALSE(store.has_discarded_trial());
  EXPECT_EQ(store.load().error().message, "list failed");
  EXPECT_EQ(store.load(1).error().message, "list failed");
  EXPECT_EQ(store.epoch().error().message, "list failed");
  expect_error(store.stage(Bytes(30, 3)), "list failed");
  expect_error(store.confirm(), "list failed");
  expect_error(store.undo(), "list failed");
  mend();
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
  EXPECT_EQ(medium_->names().size(), 2U);
}

TEST_F(SlotStoreMedium, WhatCannotBeRemovedAtTheStartIsSaid) {
  for (const char* name : {"incoming.tmp", "trial.safetensors"}) {
    test::Names names = two();
    names[name] = test::kept(Bytes(5, 5));
    const SlotStore store = open(names, FailingMedium::after(Call::kRemove));
    EXPECT_EQ(store.problem(), "remove failed") << name;
    EXPECT_EQ(store.has_discarded_trial(), std::string(name) == "trial.safetensors");
    EXPECT_EQ(store.load().value(), Bytes(20, 2)) << "in use all the same";
  }
}

// Each call of a flash, up to the one that puts it on trial.
TEST_F(SlotStoreMedium, AStageWhoseCallFailsLeavesNothing) {
  struct Case {
    FailingMedium::Fails fails;
    const char* said;
  };
  for (const Case& c : {Case{FailingMedium::after(Call::kList, "", 1), "list failed"},  // the second: what to clear
                        Case{FailingMedium::after(Call::kCreate), "create failed"},
                        Case{FailingMedium::after(Call::kWrite), "write failed"},
                        Case{FailingMedium::after(Call::kSync), "sync failed"},
                        Case{FailingMedium::after(Call::kRead, "incoming.tmp"), "read failed"},
                        Case{FailingMedium::after(Call::kRename, "incoming.tmp"), "rename failed"},
                        Case{FailingMedium::after(Call::kSyncFolder), "sync_folder failed"}}) {
    SlotStore store = open(two());
    medium_->fails = c.fails;
    expect_error(store.stage(Bytes(30, 3)), c.said);
    mend();
    EXPECT_EQ(medium_->names().size(), 2U) << c.said;
    EXPECT_EQ(store.load().value(), Bytes(20, 2)) << c.said;
    ASSERT_TRUE(test::install(store, Bytes(30, 3))) << c.said << ", and then it can be flashed";
    EXPECT_EQ(store.load().value(), Bytes(30, 3)) << c.said;
  }
}

// A file that a flash left behind, and that cannot be removed, is in the way of the next one.
TEST_F(SlotStoreMedium, AnUploadThatCannotBeClearedIsInTheWayOfTheNext) {
  test::Names names = two();
  names["incoming.tmp"] = test::kept(Bytes(5, 5));
  SlotStore store = open(names, FailingMedium::after(Call::kRemove));
  expect_error(store.stage(Bytes(30, 3)), "remove failed");
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
  EXPECT_EQ(medium_->names().count("trial.safetensors"), 0U);
}

// Somebody put the last number there while a trial ran.
TEST_F(SlotStoreMedium, WhereNoNumberIsLeftATrialCannotBeConfirmed) {
  test::Names names = two();
  names["calibration-18446744073709551614.safetensors"] = test::kept(Bytes(7, 7));
  names.erase(kSecond);
  SlotStore store = open(names);
  const Status confirmed = store.confirm();
  ASSERT_FALSE(confirmed);
  EXPECT_NE(confirmed.error().message.find("no number is left"), std::string::npos) << confirmed.error().message;
  EXPECT_EQ(medium_->names().size(), 2U);
}

TEST_F(SlotStoreMedium, AnUndoThatCannotRenameIsNone) {
  SlotStore store = open(two(), FailingMedium::after(Call::kRename));
  expect_error(store.undo(), "rename failed");
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
  mend();
  ASSERT_TRUE(store.undo());
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
}

// What is too old is removed after the new file is in force; where that fails nothing is lost.
TEST_F(SlotStoreMedium, AnOldFileThatCannotBeRemovedTakesRoomAndNoMore) {
  SlotStore store = open(two());
  ASSERT_TRUE(store.stage(Bytes(30, 3)));
  medium_->fails = FailingMedium::after(Call::kRemove, kFirst);
  EXPECT_TRUE(store.confirm());
  EXPECT_EQ(medium_->names().count(kFirst), 1U);
  EXPECT_EQ(store.load().value(), Bytes(30, 3));
  EXPECT_EQ(store.load(1).value(), Bytes(20, 2));
  mend();
  ASSERT_TRUE(test::install(store, Bytes(40, 4)));
  EXPECT_EQ(medium_->names().size(), 2U) << "it goes the next time";
}

}  // namespace
}  // namespace ruffini
