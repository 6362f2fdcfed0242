#include "store/last_run.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <vector>

namespace ruffini {
namespace {

class LastRunTest : public testing::Test {
 protected:
  LastRunTest() { std::filesystem::create_directories(folder_); }
  ~LastRunTest() override { std::filesystem::remove_all(folder_); }

  // A run in a process of its own that ends as `end` does.
  void run(const std::function<void()>& end) const {
    const pid_t child = ::fork();
    if (child == 0) {
      {
        const RunRecord record(folder_);
        end();
      }
      ::_exit(0);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
  }
  [[nodiscard]] std::optional<LastRun> last() const { return RunRecord(folder_).last(); }

  std::string folder_ = testing::TempDir() + "last_run" + std::to_string(::getpid());
};

TEST_F(LastRunTest, TheFirstStartHasNoneAndAnEndThatWasAskedForIsSaid) {
  EXPECT_FALSE(last().has_value());
  const auto before = last();
  ASSERT_TRUE(before.has_value());
  EXPECT_EQ(before->end, RunEnd::kStopped);
  EXPECT_EQ(before->crashes, 0U);
}

TEST_F(LastRunTest, ACrashSaysSignalThreadCalibrationAndWhoWasStuck) {
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT}) {
    run([&] {
      RunRecord::name_thread("frame");
      RunRecord::note_calibration(0x01020384);
      RunRecord::note_stuck("network");
      ::raise(signal);
    });
    const auto before = last();
    ASSERT_TRUE(before.has_value());
    EXPECT_EQ(before->end, RunEnd::kCrashed);
    EXPECT_EQ(before->signal, static_cast<uint32_t>(signal));
    EXPECT_EQ(before->thread, "frame");
    EXPECT_EQ(before->stuck, "network");
    EXPECT_EQ(before->calibration_id, "\x01\x02\x03\x84");
    EXPECT_EQ(before->crashes, 1U) << "the run that asked ended well";
    EXPECT_LT(before->uptime_us, 5'000'000U);
  }
}

TEST_F(LastRunTest, AKilledRunWasCut) {
  run([] { ::raise(SIGKILL); });
  EXPECT_EQ(last()->end, RunEnd::kCut);
}

TEST_F(LastRunTest, ThreeCrashesSoonAfterTheirStartLeadToSafeModeUntilARunEndsWell) {
  run([] { ::abort(); });
  run([] { ::abort(); });
  run([] { ::abort(); });
  {
    const RunRecord record(folder_);
    EXPECT_TRUE(record.is_safe_mode());
    EXPECT_EQ(record.last()->crashes, 3U);
  }
  EXPECT_FALSE(RunRecord(folder_).is_safe_mode());
}

TEST_F(LastRunTest, ADamagedRecordIsNoRecord) {
  run([] { ::abort(); });
  const std::string path = folder_ + "/last-run";
  std::ifstream in(path, std::ios::binary);
  const std::vector<char> good{std::istreambuf_iterator<char>(in), {}};
  ASSERT_EQ(good.size(), 64U);
  for (size_t bit = 0; bit < 8 * good.size(); ++bit) {
    std::vector<char> bad = good;
    bad[bit / 8] = static_cast<char>(bad[bit / 8] ^ (1 << bit % 8));
    std::ofstream(path, std::ios::binary).write(bad.data(), static_cast<std::streamsize>(bad.size()));
    EXPECT_FALSE(last().has_value()) << bit;
  }
  for (size_t n = 0; n < good.size(); ++n) {
    std::ofstream(path, std::ios::binary).write(good.data(), static_cast<std::streamsize>(n));
    EXPECT_FALSE(last().has_value()) << n;
  }
}

TEST_F(LastRunTest, AFolderThatCannotBeWrittenKeepsNone) {
  EXPECT_FALSE(RunRecord(folder_ + "/none").last().has_value());
  std::filesystem::create_symlink(folder_ + "/elsewhere", folder_ + "/last-run");
  EXPECT_FALSE(RunRecord(folder_).last().has_value());
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/elsewhere")) << "a link is not followed";
}

}  // namespace
}  // namespace ruffini
