// The real calibration store on the real kernel, with one thing going wrong at a time:
//
//   errno    each call fails with each error, once and from then on, or moves one byte only
//   kill     the process dies before and after each call, and the one that is started after it at each of its own
//   cut      a real ext4 on a loop device is shut down before and after each call, with and without its log
//
// RUFFINI_SOAK=1 (`make soak`) cuts at every call of every scenario, else at each sixth.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/loop.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "base/unique_fd.h"
#include "store/slot_store.h"
#include "support/faulty_calls.h"
#include "support/install.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;
using test::Strike;

constexpr size_t kBytes = 16 << 10;
constexpr unsigned long kExt4Shutdown = 0x8004587D;

Bytes table(uint8_t seed) {
  Bytes out(kBytes);
  for (size_t i = 0; i < kBytes; ++i) out[i] = static_cast<uint8_t>((i + 1) * (2 * size_t{seed} + 3) + (i >> 8));
  return out;
}

// What the store was asked for and what it said, visible to the parent of a process that dies.
struct Progress {
  bool is_confirm_asked = false;
  bool is_confirmed = false;
  bool is_undo_asked = false;
  bool is_undone = false;
  bool has_read_wrong = false;
};

using Work = void (*)(const std::string& folder, Progress& progress);

struct Scenario {
  const char* name;
  std::vector<uint8_t> before;  // seeds of the tables in force one after the other
  bool has_leftovers;
  Work work;
  Bytes new_one;  // that a confirm or an undo puts in force
};

void flash(const std::string& folder, Progress& progress) {
  auto store = SlotStore::open(folder);
  if (!store || !store.value().stage(table(9))) return;
  progress.is_confirm_asked = true;
  progress.is_confirmed = store.value().confirm().has_value();
  const auto now = store.value().load();
  progress.has_read_wrong = progress.is_confirmed && now && now.value() != table(9);
}

void fail_trial(const std::string& folder, Progress& /*progress*/) {
  auto store = SlotStore::open(folder);
  if (store && store.value().stage(table(9))) (void)store.value().reject();
}

void undo(const std::string& folder, Progress& progress) {
  auto store = SlotStore::open(folder);
  if (!store) return;
  progress.is_undo_asked = true;
  progress.is_undone = store.value().undo().has_value();
}

void read_both(const std::string& folder, Progress& progress) {
  const auto store = SlotStore::open(folder);
  if (!store) return;
  const auto now = store.value().load();
  const auto before = store.value().load(1);
  progress.has_read_wrong = (now && now.value() != table(4)) || (before && before.value() != table(3));
}

// What a device does at its start, after whatever happened.
void start(const std::string& folder, Progress& /*progress*/) {
  const auto store = SlotStore::open(folder);
  if (!store) return;
  (void)store.value().load();
  (void)store.value().load(1);
}

const std::vector<Scenario>& scenarios() {
  static const std::vector<Scenario> all = {
      {"first flash", {}, false, flash, table(9)},
      {"flash", {2, 3, 4}, true, flash, table(9)},
      {"a trial that fails", {3, 4}, false, fail_trial, {}},
      {"undo", {3, 4}, false, undo, table(3)},
      {"start", {3, 4}, true, read_both, {}},
  };
  return all;
}

void prepare(const std::string& folder, const Scenario& scenario) {
  fs::create_directories(folder);
  for (const auto& entry : fs::directory_iterator(folder)) fs::remove_all(entry);
  for (size_t i = 0; i < scenario.before.size(); ++i) {
    const Bytes bytes = table(scenario.before[i]);
    std::ofstream(folder + "/calibration-" + std::to_string(i + 1) + ".safetensors", std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  }
  if (!scenario.has_leftovers) return;
  std::ofstream(folder + "/incoming.tmp") << "half an upload";
  std::ofstream(folder + "/trial.safetensors") << "a trial";
}

// Empty: what is in force is what the scenario allows.
std::string wrong(const std::string& folder, const Scenario& scenario, const Progress& progress) {
  if (progress.has_read_wrong) return "wrong bytes were read";
  const auto store = SlotStore::open(folder);
  if (!store) return store.error().message;
  const auto now = store.value().load();
  if (!now) return now.error().message;
  const Bytes old_one = scenario.before.empty() ? Bytes{} : table(scenario.before.back());
  const bool is_new = now.value() == scenario.new_one && (progress.is_confirm_asked || progress.is_undo_asked);
  if (is_new) return "";
  if (progress.is_confirmed || progress.is_undone) return "success was said, and the new file is not in force";
  return now.value() == old_one ? "" : "another file is in force";
}

int count_calls(const std::string& folder, const Scenario& scenario) {
  prepare(folder, scenario);
  Progress progress;
  test::arm({.has_no_sync = true});
  scenario.work(folder, progress);
  const int n = test::disarm();
  EXPECT_EQ(wrong(folder, scenario, progress), "") << scenario.name;
  return n;
}

// The work in a process that ends at the strike; whether it did.
bool dies(const std::string& folder, Work work, const Strike& strike, Progress& progress) {
  progress = {};
  const pid_t child = ::fork();
  if (child == 0) {
    test::arm(strike);
    work(folder, progress);
    ::_exit(0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 137;
}

// Of one page for each call, never given back.
Progress& shared_progress() {
  void* page = ::mmap(nullptr, sizeof(Progress), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  return *new (page) Progress;
}

size_t n_open_files() {
  return static_cast<size_t>(std::distance(fs::directory_iterator("/proc/self/fd"), fs::directory_iterator()));
}

class StoreFaults : public testing::Test {
 protected:
  StoreFaults() { fs::remove_all(folder_); }
  ~StoreFaults() override { fs::remove_all(folder_); }
  int die_at_each_call_of_a_start(const Scenario& scenario, const Progress& first);
  const std::string folder_ = testing::TempDir() + "store_faults_test" + std::to_string(::getpid());
};

TEST_F(StoreFaults, EveryFailingCallLeavesTheOldFileOrTheNewOneAndIsSaid) {
  const std::vector<int> errors = {EIO, ENOSPC, EROFS, EDQUOT, EMFILE, ENFILE, ENOMEM, EACCES, ENOENT, EINTR};
  int n_runs = 0;
  const size_t n_files = n_open_files();
  for (const Scenario& scenario : scenarios()) {
    const int n_calls = count_calls(folder_, scenario);
    for (int at = 1; at <= n_calls; ++at) {
      std::vector<Strike> strikes = {{.at = at, .n_bytes = 1, .has_no_sync = true}};
      for (const int error : errors) {
        for (const bool is_forever : {false, true}) {
          if (is_forever && error == EINTR) continue;  // a call that is interrupted is made again, for ever
          strikes.push_back({.at = at, .is_forever = is_forever, .error = error, .has_no_sync = true});
        }
      }
      for (const Strike& strike : strikes) {
        prepare(folder_, scenario);
        Progress progress;
        test::arm(strike);
        scenario.work(folder_, progress);
        test::disarm();
        ASSERT_EQ(wrong(folder_, scenario, progress), "")
            << scenario.name << ", call " << at << ", errno " << strike.error << (strike.is_forever ? " for ever" : "");
        if (strike.n_bytes == 1) {  // no error: the rest is to be asked for
          ASSERT_EQ(progress.is_confirmed || progress.is_undone, !scenario.new_one.empty()) << scenario.name << at;
        }
        ++n_runs;
      }
    }
  }
  EXPECT_EQ(n_open_files(), n_files);
  std::printf("%d runs with a failing call\n", n_runs);
  EXPECT_GE(n_runs, 1'500);
}

// A file system that came up read-only after an error: what is there measures, and a flash is refused with the reason.
TEST_F(StoreFaults, AReadOnlyMediumAtStartIsReadAndRefusesAFlash) {
  prepare(folder_, {"start", {3, 4}, true, read_both, {}});
  test::arm({.at = 1, .is_forever = true, .error = EROFS, .is_of_writing = true});
  auto opened = SlotStore::open(folder_);
  const bool is_open = opened.has_value();
  const auto now = is_open ? opened.value().load() : Result<Bytes>(Bytes{});
  const auto before = is_open ? opened.value().load(1) : Result<Bytes>(Bytes{});
  const Status can_write = is_open ? opened.value().can_write() : Status(Unit{});
  const Status staged = is_open ? opened.value().stage(table(9)) : Status(Unit{});
  test::disarm();
  ASSERT_TRUE(is_open);
  SlotStore store = std::move(opened).value();
  EXPECT_EQ(now.value(), table(4));
  EXPECT_EQ(before.value(), table(3));
  for (const Status& refused : {can_write, staged}) {
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().kind, ErrorKind::kStorage);
    EXPECT_NE(refused.error().message.find("Read-only file system"), std::string::npos) << refused.error().message;
  }
  EXPECT_NE(store.problem().find("nothing can be flashed"), std::string::npos) << store.problem();
  EXPECT_TRUE(test::install(store, table(9))) << "it is writable again";
  EXPECT_EQ(store.load().value(), table(9));
}

// Somebody planted what is no calibration under the store's names: links that lead out, pipes, folders.
TEST_F(StoreFaults, WhatIsPlantedUnderTheStoresNamesIsNeverFollowedNorWaitedFor) {
  const std::string outside = folder_ + "_outside";
  int n_plants = 0;
  for (const std::string name : {"calibration-5.safetensors", "incoming.tmp", "trial.safetensors"}) {
    for (const std::string kind : {"symlink", "dangling", "hardlink", "pipe", "folder"}) {
      fs::remove_all(folder_);
      fs::create_directories(folder_);
      prepare(folder_, {"planted", {3, 4}, false, read_both, {}});
      std::ofstream(outside) << "precious";
      const std::string path = folder_ + "/" + name;
      if (kind == "symlink") fs::create_symlink(outside, path);
      if (kind == "dangling") fs::create_symlink(outside + "_nowhere", path);
      if (kind == "hardlink") fs::create_hard_link(outside, path);
      ASSERT_EQ(kind == "pipe" ? ::mkfifo(path.c_str(), 0600) : 0, 0);
      if (kind == "folder") fs::create_directories(path + "/with_something_in_it");
      SCOPED_TRACE(testing::Message() << kind << " at " << name);
      SlotStore store = SlotStore::open(folder_).value();
      const bool is_slot = name == "calibration-5.safetensors";
      const auto now = store.load();
      // What a hard link leads to is read as it is; its signature tells that it is no calibration.
      EXPECT_EQ(now && now.value() == table(4), !is_slot);
      EXPECT_EQ(now.has_value(), !is_slot || kind == "hardlink");
      EXPECT_EQ(store.load(1).value(), table(is_slot ? 4 : 3));
      const Status installed = test::install(store, table(9));
      // A folder is not ours to remove; all else gives way.
      EXPECT_EQ(installed.has_value(), is_slot || kind != "folder");
      EXPECT_EQ(store.load().value(), table(installed ? 9 : 4));
      EXPECT_FALSE(fs::exists(outside + "_nowhere"));
      std::string kept;
      std::getline(std::ifstream(outside) >> std::ws, kept);
      EXPECT_EQ(kept, "precious");
      ++n_plants;
    }
  }
  fs::remove(outside);
  std::printf("%d plants\n", n_plants);
  EXPECT_GE(n_plants, 12);
}

// From what a first death left, each time. How many starts died.
int StoreFaults::die_at_each_call_of_a_start(const Scenario& scenario, const Progress& first) {
  Progress& second = shared_progress();
  const std::string left = folder_ + "_left";
  fs::remove_all(left);
  fs::copy(folder_, left);
  int n = 0;
  for (bool is_dead = true; is_dead; ++n) {
    fs::remove_all(folder_);
    fs::copy(left, folder_);
    const Strike strike{.at = n + 1, .stop = [] { ::_exit(137); }, .has_no_sync = true};
    is_dead = dies(folder_, start, strike, second);
    EXPECT_EQ(wrong(folder_, scenario, first), "") << scenario.name << ", then call " << n + 1 << " of the start";
  }
  fs::remove_all(folder_);
  fs::rename(left, folder_);
  return n - 1;
}

TEST_F(StoreFaults, AProcessThatDiesAtAnyCallLeavesTheOldFileOrTheNewOne) {
  int n_kills = 0;
  int n_again = 0;
  Progress& progress = shared_progress();
  for (const Scenario& scenario : scenarios()) {
    const int n_calls = count_calls(folder_, scenario);
    for (int at = 1; at <= n_calls; ++at) {
      for (const bool is_after : {false, true}) {
        prepare(folder_, scenario);
        const Strike strike{.at = at, .is_after = is_after, .stop = [] { ::_exit(137); }, .has_no_sync = true};
        ASSERT_TRUE(dies(folder_, scenario.work, strike, progress)) << scenario.name << ", call " << at;
        ++n_kills;
        n_again += die_at_each_call_of_a_start(scenario, progress);
        ASSERT_EQ(wrong(folder_, scenario, progress), "") << scenario.name << ", call " << at;
      }
    }
  }
  std::printf("%d kills: before and after each call; %d of the start after it\n", n_kills, n_again);
  EXPECT_GE(n_kills, 160) << "fewer calls than there were";
  EXPECT_GE(n_again, 1'000) << "a start makes fewer calls than it did";
}

// A file system of 4 MiB in a file. The loop device is a new one at each mount: what the old one had in its cache is
// gone.
class Ext4 {
 public:
  explicit Ext4(const std::string& folder) : image_(folder + "/ext4.img"), mounted_(folder + "/ext4") {
    fs::create_directories(mounted_);
    std::ofstream(image_).close();
    fs::resize_file(image_, 4 << 20);
    is_there_ = std::system(("mkfs.ext4 -q -F -b 1024 " + image_ + " 2>/dev/null").c_str()) == 0 && mount();
  }
  ~Ext4() { unmount(); }
  Ext4(const Ext4&) = delete;
  Ext4& operator=(const Ext4&) = delete;

  [[nodiscard]] bool is_there() const { return is_there_; }
  [[nodiscard]] std::string store() const { return mounted_ + "/store"; }
  // A few tries: between asking for a free loop device and taking it, somebody else may have taken it.
  [[nodiscard]] bool mount() {
    bool is_mounted = false;
    for (int i = 0; i < 5 && !is_mounted; ++i) is_mounted = mount_once();
    return is_mounted;
  }
  [[nodiscard]] bool mount_once() {
    const UniqueFd control(::open("/dev/loop-control", O_RDWR | O_CLOEXEC));
    const int number = control ? ::ioctl(control.get(), LOOP_CTL_GET_FREE) : -1;
    if (number < 0) return false;
    const std::string device = "/dev/loop" + std::to_string(number);
    const UniqueFd backing(::open(image_.c_str(), O_RDWR | O_CLOEXEC));
    loop_.reset(::open(device.c_str(), O_RDWR | O_CLOEXEC));
    return loop_ && ::ioctl(loop_.get(), LOOP_SET_FD, backing.get()) == 0 &&
           ::mount(device.c_str(), mounted_.c_str(), "ext4", MS_NOATIME, "") == 0;
  }
  void unmount() {
    ::umount2(mounted_.c_str(), 0);
    if (loop_) ::ioctl(loop_.get(), LOOP_CLR_FD, 0);
    loop_.reset(-1);
  }
  // What was written so far is on the medium.
  void sync() const {
    const int fd = ::open(mounted_.c_str(), O_RDONLY | O_CLOEXEC);
    ::syncfs(fd);
    ::close(fd);
  }
  // The power goes: nothing reaches the medium from now on; with its log, or without.
  void shut_down(bool with_log) const {
    const int fd = ::open(mounted_.c_str(), O_RDONLY | O_CLOEXEC);
    uint32_t flags = with_log ? 1 : 2;
    if (::ioctl(fd, kExt4Shutdown, &flags) != 0) std::perror("the file system cannot be shut down");
    ::close(fd);
  }

 private:
  std::string image_;
  std::string mounted_;
  UniqueFd loop_;
  bool is_there_ = false;
};

TEST_F(StoreFaults, APowerCutOfARealFileSystemLeavesTheOldFileOrTheNewOne) {
  fs::create_directories(folder_);
  Ext4 medium(folder_);
  if (!medium.is_there()) GTEST_SKIP() << "needs root, a free loop device and mkfs.ext4";
  const char* said = std::getenv("RUFFINI_SOAK");
  const int step = said != nullptr && std::string(said) == "1" ? 1 : 6;
  int n_cuts = 0;
  int n_new = 0;
  Progress& progress = shared_progress();
  for (const Scenario& scenario : scenarios()) {
    const int n_calls = count_calls(medium.store(), scenario);
    for (int at = 1; at <= 4 * n_calls; at += step) {
      const bool is_after = at % 2 == 0;
      const bool with_log = at % 4 < 2;
      prepare(medium.store(), scenario);
      medium.sync();
      const Strike strike{.at = (at + 3) / 4, .is_after = is_after, .stop = [&] {
                            test::disarm();
                            medium.shut_down(with_log);
                            ::_exit(137);
                          }};
      ASSERT_TRUE(dies(medium.store(), scenario.work, strike, progress)) << scenario.name << ", cut " << at;
      medium.unmount();
      ASSERT_TRUE(medium.mount()) << "the file system does not come back";
      ASSERT_EQ(wrong(medium.store(), scenario, progress), "")
          << scenario.name << ", " << (is_after ? "after" : "before") << " call " << (at + 3) / 4
          << (with_log ? ", with the log" : "");
      n_new += progress.is_confirmed || progress.is_undone ? 1 : 0;
      ++n_cuts;
    }
  }
  std::printf("%d cuts of a real ext4, %d of them after success was said\n", n_cuts, n_new);
  EXPECT_GE(n_cuts * step, 300);
}

}  // namespace
}  // namespace ruffini
