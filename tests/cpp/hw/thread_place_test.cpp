#include "hw/thread_place.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <iterator>
#include <string>
#include <thread>

namespace ruffini {
namespace {

std::string in_a_thread(const std::string& role, const ThreadSettings& wanted, std::string* placed = nullptr,
                        size_t* only_cpu = nullptr) {
  std::string said;
  std::thread([&] {
    said = place_thread(role, wanted);
    if (placed != nullptr) *placed = thread_placement();
    cpu_set_t set;
    CPU_ZERO(&set);
    ASSERT_EQ(::sched_getaffinity(0, sizeof set, &set), 0);
    if (only_cpu == nullptr) return;
    ASSERT_EQ(CPU_COUNT(&set), 1);
    for (*only_cpu = 0; !CPU_ISSET(*only_cpu, &set);) ++*only_cpu;
  }).join();
  return said;
}

// The last CPU that this process may use, asked of the kernel.
size_t last_cpu() {
  cpu_set_t set;
  CPU_ZERO(&set);
  EXPECT_EQ(::sched_getaffinity(0, sizeof set, &set), 0);
  size_t last = 0;
  for (size_t i = 0; i < 64; ++i) last = CPU_ISSET(i, &set) ? i : last;
  return last;
}

TEST(ThreadPlace, WhatIsNotAskedStaysAsItIs) {
  std::string placed;
  EXPECT_EQ(in_a_thread("frame", {}, &placed), "");
  EXPECT_EQ(placed, thread_placement());
}

TEST(ThreadPlace, TheThreadIsBoundToItsCpuAndNoOtherIs) {
  const size_t cpu = last_cpu();
  const std::string before = thread_placement();
  size_t found = 64;
  EXPECT_EQ(in_a_thread("capture", {0, uint64_t{1} << cpu}, nullptr, &found), "");
  EXPECT_EQ(found, cpu);
  EXPECT_EQ(thread_placement(), before);
}

TEST(ThreadPlace, ACpuThatIsNotThereIsSaidWithTheKey) {
  const std::string before = thread_placement();
  std::string placed;
  const std::string alone = in_a_thread("link", {0, uint64_t{1} << 63}, &placed);
  EXPECT_NE(alone.find("thread link: CPU 63: this computer gives it"), std::string::npos) << alone;
  EXPECT_NE(alone.find("threads.link_cpus"), std::string::npos) << alone;
  EXPECT_EQ(placed, before);
  // Of two the one that there is.
  const size_t cpu = last_cpu();
  const std::string both = in_a_thread("link", {0, uint64_t{1} << 63 | uint64_t{1} << cpu}, &placed);
  EXPECT_NE(both.find("gives it " + std::to_string(cpu) + " (before"), std::string::npos) << both;
}

// In a process of its own that has given its rights away; what it said comes back by a file.
template <typename Body>
std::string without_rights(rlim_t limit, Body body) {
  const std::string path = testing::TempDir() + "thread_place_" + std::to_string(::getpid());
  {
    std::ofstream make(path);
  }
  EXPECT_EQ(::access(path.c_str(), W_OK), 0);
  std::ofstream out(path);
  const pid_t child = ::fork();
  if (child == 0) {
    const rlimit most{limit, limit};
    const bool is_set = ::setrlimit(RLIMIT_RTPRIO, &most) == 0 && (::geteuid() != 0 || ::setuid(65'534) == 0);
    out << (is_set ? body() : "rights could not be given away") << std::flush;
    ::_exit(0);
  }
  int status = 0;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  std::ifstream in(path);
  std::string said{std::istreambuf_iterator<char>(in), {}};
  ::unlink(path.c_str());
  return said;
}

TEST(ThreadPlace, WithoutTheRightItGoesOnAndNamesTheRemedy) {
  const std::string said = without_rights(0, [] {
    const std::string problem = place_thread("frame", {45, 0});
    return problem + " | " + thread_placement();
  });
  EXPECT_NE(
      said.find("thread frame: real-time priority 45 cannot be had (Operation not permitted): set LimitRTPRIO=45"),
      std::string::npos)
      << said;
  EXPECT_NE(said.find("| ordinary on CPU"), std::string::npos) << said;
}

// As the service starts it: FIFO from outside, then no right to more than the limit.
TEST(ThreadPlace, AThreadThatIsRealTimeAlreadyMayBeGivenLess) {
  sched_param forty{};
  forty.sched_priority = 40;
  sched_param before{};
  ASSERT_EQ(::sched_getparam(0, &before), 0);
  const int policy = ::sched_getscheduler(0);
  if (::sched_setscheduler(0, SCHED_FIFO, &forty) != 0) GTEST_SKIP() << "not allowed here";
  const std::string said = without_rights(0, [] {
    const std::string less = place_thread("link", {20, 0});
    const std::string after = thread_placement();
    return less + "|" + after + "|" + place_thread("link", {41, 0});
  });
  ASSERT_EQ(::sched_setscheduler(0, policy, &before), 0);
  EXPECT_EQ(said.rfind("|FIFO 20 on CPU", 0), 0U) << said;
  EXPECT_NE(said.find("real-time priority 41 cannot be had"), std::string::npos) << said;
}

}  // namespace
}  // namespace ruffini
