#include "store/slot_store.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <filesystem>
#include <fstream>

#include "support/install.h"

namespace {

// A medium that fails at one point of install(), by taking the place of the C library's functions in this program.
enum class Fault { kNone, kFileSync, kReadBack, kRename, kFolderSync };
Fault g_fault = Fault::kNone;

int fail_with(int error) {
  errno = error;
  return -1;
}

bool is_folder(int fd) {
  struct stat status{};
  return ::fstat(fd, &status) == 0 && S_ISDIR(status.st_mode);
}

}  // namespace

extern "C" {

int fsync(int fd) {
  if (g_fault == (is_folder(fd) ? Fault::kFolderSync : Fault::kFileSync)) return fail_with(EIO);
  return static_cast<int>(::syscall(SYS_fsync, fd));
}

int renameat(int from_folder, const char* from, int to_folder, const char* to) noexcept {
  if (g_fault == Fault::kRename) return fail_with(EROFS);
  return static_cast<int>(::syscall(SYS_renameat2, from_folder, from, to_folder, to, 0));
}

// Called before the read-back: what is on the medium is no longer what was written.
int posix_fadvise(int fd, off_t, off_t, int) noexcept {
  if (g_fault == Fault::kReadBack) {
    const std::string name = "/proc/self/fd/" + std::to_string(fd);
    const int again = ::open(name.c_str(), O_WRONLY | O_CLOEXEC);
    EXPECT_EQ(::pwrite(again, "x", 1, 0), 1);
    ::close(again);
  }
  return 0;
}

}  // extern "C"

namespace ruffini {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;
using test::install;

class SlotStoreTest : public testing::Test {
 protected:
  SlotStoreTest() : folder_(fs::path(testing::TempDir()) / ("slot_store_test" + std::to_string(::getpid()))) {
    fs::remove_all(folder_);
  }
  ~SlotStoreTest() override { fs::remove_all(folder_); }
  [[nodiscard]] SlotStore open() const { return SlotStore::open(folder_.string()).value(); }
  [[nodiscard]] bool has(const char* name) const { return fs::exists(folder_ / name); }
  fs::path folder_;
};

TEST_F(SlotStoreTest, AnEmptyStoreHoldsNothing) { EXPECT_EQ(open().load().value(), Bytes{}); }

TEST_F(SlotStoreTest, TheNewestIsInForceAndTheOneBeforeIsKept) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(100'000, 1)));
  ASSERT_TRUE(install(store, Bytes(50, 2)));
  EXPECT_EQ(store.load().value(), Bytes(50, 2));
  EXPECT_EQ(open().load().value(), Bytes(50, 2));
  EXPECT_EQ(store.load(1).value(), Bytes(100'000, 1));
  EXPECT_FALSE(has("incoming.tmp"));
}

TEST_F(SlotStoreTest, AnUploadThatWasCutOffIsForgotten) {
  {
    SlotStore store = open();
    ASSERT_TRUE(install(store, Bytes(10, 1)));
  }
  std::ofstream(folder_ / "incoming.tmp") << "half";
  EXPECT_EQ(open().load().value(), Bytes(10, 1));
  EXPECT_FALSE(has("incoming.tmp"));
}

TEST_F(SlotStoreTest, AFullMediumLeavesWhatIsInForce) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{4'096, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const Status installed = install(store, Bytes(100'000, 2));
  setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_FALSE(installed);
  EXPECT_EQ(installed.error().kind, ErrorKind::kStorage);
  EXPECT_NE(installed.error().message.find("incoming.tmp"), std::string::npos) << installed.error().message;
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
}

// Before the rename the old file stays in force, and nothing of the new one is left.
TEST_F(SlotStoreTest, AMediumThatFailsLeavesWhatIsInForce) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  for (const Fault fault : {Fault::kFileSync, Fault::kReadBack, Fault::kRename}) {
    g_fault = fault;
    const Status installed = install(store, Bytes(20, 2));
    g_fault = Fault::kNone;
    ASSERT_FALSE(installed) << static_cast<int>(fault);
    EXPECT_EQ(installed.error().kind, ErrorKind::kStorage);
    EXPECT_NE(installed.error().message.find(folder_.string()), std::string::npos) << installed.error().message;
    EXPECT_EQ(store.load().value(), Bytes(10, 1)) << static_cast<int>(fault);
    EXPECT_FALSE(has("incoming.tmp")) << static_cast<int>(fault);
  }
  ASSERT_TRUE(install(store, Bytes(20, 2)));
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
}

TEST_F(SlotStoreTest, WhatIsOnTrialIsNotInForceUntilItIsConfirmed) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  ASSERT_TRUE(store.stage(Bytes(20, 2)));
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
  ASSERT_TRUE(store.stage(Bytes(30, 3)));  // in the place of the first
  ASSERT_TRUE(store.confirm());
  EXPECT_EQ(store.load().value(), Bytes(30, 3));
  EXPECT_EQ(store.load(1).value(), Bytes(10, 1));
  ASSERT_TRUE(store.stage(Bytes(40, 4)));
  ASSERT_TRUE(store.reject());
  EXPECT_EQ(store.load().value(), Bytes(30, 3));
  EXPECT_FALSE(has("trial.safetensors"));
}

TEST_F(SlotStoreTest, ATrialThatARestartCutShortIsRemovedAndSaid) {
  {
    SlotStore store = open();
    ASSERT_TRUE(install(store, Bytes(10, 1)));
    EXPECT_FALSE(store.has_discarded_trial());
    ASSERT_TRUE(store.stage(Bytes(20, 2)));
  }
  EXPECT_TRUE(open().has_discarded_trial());
  EXPECT_FALSE(has("trial.safetensors"));
  EXPECT_FALSE(open().has_discarded_trial());
  EXPECT_EQ(open().load().value(), Bytes(10, 1));
}

// Only the names that the store itself gives are calibrations.
TEST_F(SlotStoreTest, NamesThatItWouldNotGiveAreNotRead) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  for (const char* odd :
       {"calibration-007.safetensors", "calibration-x.safetensors", "calibration-9.safetensors.bak",
        "calibration-.safetensors", "calibration--9.safetensors", "calibration-18446744073709551615.safetensors",
        "calibration-99999999999999999999.safetensors", "kalibrierung-9.safetensors"}) {
    std::ofstream(folder_ / odd) << "odd";
    EXPECT_EQ(store.load().value(), Bytes(10, 1)) << odd;
  }
  ASSERT_TRUE(install(store, Bytes(20, 2)));
  EXPECT_TRUE(has("calibration-2.safetensors"));
  EXPECT_TRUE(has("calibration-007.safetensors")) << "not ours to remove";
}

// Somebody put a file there under the last number that there is: a new one could be called in force and not be so.
TEST_F(SlotStoreTest, WhereNoNumberIsLeftNothingIsTaken) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  std::ofstream(folder_ / "calibration-18446744073709551614.safetensors") << "last";
  EXPECT_EQ(store.load().value(), (Bytes{'l', 'a', 's', 't'}));
  for (const Status& done : {store.stage(Bytes(20, 2)), store.undo()}) {
    ASSERT_FALSE(done);
    EXPECT_EQ(done.error().kind, ErrorKind::kStorage);
    EXPECT_NE(done.error().message.find("18446744073709551614"), std::string::npos) << done.error().message;
  }
  EXPECT_FALSE(has("trial.safetensors"));
  EXPECT_EQ(store.load(1).value(), Bytes(10, 1));
}

// Tried again, an undo that failed must not take itself back and call that done.
TEST_F(SlotStoreTest, AnUndoWhoseFolderIsNotSyncedIsNoneAndCanBeTriedAgain) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  ASSERT_TRUE(install(store, Bytes(20, 2)));
  g_fault = Fault::kFolderSync;
  const Status undone = store.undo();
  g_fault = Fault::kNone;
  ASSERT_FALSE(undone);
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
  ASSERT_TRUE(store.undo());
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
  EXPECT_EQ(store.load(1).value(), Bytes(20, 2));
}

// The name that carries the epoch is itself renamed by the second undo.
TEST_F(SlotStoreTest, TheSecurityEpochOutlivesEveryUndo) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  ASSERT_TRUE(store.stage(Bytes(20, 2)));
  ASSERT_TRUE(store.confirm(3));
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(store.undo());
    EXPECT_EQ(store.epoch().value(), 3U) << i;
  }
}

TEST_F(SlotStoreTest, ATrialWhoseFolderIsNotSyncedIsNone) {
  SlotStore store = open();
  g_fault = Fault::kFolderSync;
  const Status staged = store.stage(Bytes(20, 2));
  g_fault = Fault::kNone;
  ASSERT_FALSE(staged);
  EXPECT_FALSE(has("trial.safetensors"));
}

TEST_F(SlotStoreTest, AMediumThatFailsWhenATrialIsConfirmedLeavesWhatIsInForce) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  ASSERT_TRUE(store.stage(Bytes(20, 2)));
  g_fault = Fault::kRename;
  const Status confirmed = store.confirm();
  g_fault = Fault::kNone;
  ASSERT_FALSE(confirmed);
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
  EXPECT_TRUE(has("trial.safetensors"));
}

// After the rename the new one has the name; that the folder may not be durable is said.
TEST_F(SlotStoreTest, AFolderThatIsNotSyncedIsSaid) {
  SlotStore store = open();
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  ASSERT_TRUE(store.stage(Bytes(20, 2)));
  g_fault = Fault::kFolderSync;
  const Status installed = store.confirm();
  g_fault = Fault::kNone;
  ASSERT_FALSE(installed);
  EXPECT_EQ(store.load().value(), Bytes(20, 2));
  EXPECT_EQ(store.load(1).value(), Bytes(10, 1));
  EXPECT_FALSE(store.is_durable());
  EXPECT_TRUE(store.sync());
  EXPECT_TRUE(store.is_durable());
  EXPECT_EQ(store.unsynced(), "");
}

TEST_F(SlotStoreTest, AStartThatCannotMakeSureOfTheFolderSaysSo) {
  g_fault = Fault::kFolderSync;
  const SlotStore store = open();
  g_fault = Fault::kNone;
  EXPECT_FALSE(store.is_durable());
  EXPECT_NE(store.unsynced().find("sync"), std::string::npos) << store.unsynced();
}

TEST_F(SlotStoreTest, WhatIsNoPlainFileIsNotRead) {
  SlotStore store = open();
  fs::create_directory(folder_ / "calibration-7.safetensors");
  EXPECT_EQ(store.load().error().kind, ErrorKind::kStorage);
  fs::remove(folder_ / "calibration-7.safetensors");
  fs::create_symlink("/etc/hostname", folder_ / "calibration-7.safetensors");
  EXPECT_EQ(store.load().error().kind, ErrorKind::kStorage);
  fs::remove(folder_ / "calibration-7.safetensors");
  fs::create_symlink(folder_ / "elsewhere", folder_ / "incoming.tmp");
  ASSERT_TRUE(install(store, Bytes(10, 1)));
  EXPECT_FALSE(has("elsewhere"));
}

TEST_F(SlotStoreTest, AFolderThatCannotBeMadeIsNamed) {
  std::ofstream(folder_) << "a file";
  const auto store = SlotStore::open(folder_.string());
  ASSERT_FALSE(store);
  EXPECT_EQ(store.error().kind, ErrorKind::kStorage);
  EXPECT_NE(store.error().message.find(folder_.string()), std::string::npos);
}

}  // namespace
}  // namespace ruffini
