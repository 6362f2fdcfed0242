#include "hw/thread_place.h"

#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace ruffini {
namespace {

constexpr size_t kCpus = 64;  // ThreadSettings::cpus

std::string list_of(uint64_t cpus) {
  std::string list;
  for (size_t i = 0; i < kCpus; ++i) {
    if ((cpus >> i & 1) != 0) list += (list.empty() ? "" : ",") + std::to_string(i);
  }
  return list;
}

uint64_t own_cpus() {
  cpu_set_t set;
  CPU_ZERO(&set);
  uint64_t cpus = 0;
  if (::sched_getaffinity(0, sizeof set, &set) != 0) return 0;
  for (size_t i = 0; i < kCpus; ++i) cpus |= CPU_ISSET(i, &set) ? uint64_t{1} << i : 0;
  return cpus;
}

// Returns 0 or an errno. A thread that the service started as FIFO may not set its policy again (RestrictRealtime), but
// may change its priority.
int set_priority(int priority) {
  if (::sched_getscheduler(0) == SCHED_FIFO) return pthread_setschedprio(pthread_self(), priority);
  sched_param wanted{};
  wanted.sched_priority = priority;
  return pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
}

int set_cpus(uint64_t cpus) {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (size_t i = 0; i < kCpus; ++i) {
    if ((cpus >> i & 1) != 0) CPU_SET(i, &set);
  }
  return ::sched_setaffinity(0, sizeof set, &set) == 0 ? 0 : errno;
}

}  // namespace

std::string place_thread(const std::string& role, const ThreadSettings& wanted) {
  std::string problem;
  const auto tell = [&](const std::string& what) { problem += (problem.empty() ? "" : "; ") + what; };
  const std::string name = "thread " + role + ": ";
  if (wanted.cpus != 0) {
    const uint64_t before = own_cpus();
    const int error = set_cpus(wanted.cpus);
    const std::string asked = name + "CPU " + list_of(wanted.cpus);
    if (error != 0 && error != EINVAL) {
      tell(asked + " cannot be had (" + std::strerror(error) + "): allow sched_setaffinity in the service");
    } else if (own_cpus() != wanted.cpus) {
      // The kernel accepts the existing CPUs of a mask, or rejects a mask without any.
      tell(asked + ": this computer gives it " + list_of(own_cpus()) + " (before: " + list_of(before) +
           "): correct threads." + role + "_cpus in board.toml, or the cpuset of the service");
    }
  }
  if (wanted.priority != 0) {
    if (const int error = set_priority(wanted.priority); error != 0) {
      const std::string number = std::to_string(wanted.priority);
      tell(name + "real-time priority " + number + " cannot be had (" + std::strerror(error) +
           "): set LimitRTPRIO=" + number + " in the service, or ulimit -r " + number);
    }
  }
  return problem;
}

ThreadPlace thread_place() {
  ThreadPlace place;
  sched_param now{};
  const int policy = ::sched_getscheduler(0);
  if ((policy == SCHED_FIFO || policy == SCHED_RR) && ::sched_getparam(0, &now) == 0) {
    place.priority = static_cast<uint32_t>(now.sched_priority);
  }
  const uint64_t cpus = own_cpus();
  if (std::popcount(cpus) < ::sysconf(_SC_NPROCESSORS_ONLN)) place.cpus = cpus;
  return place;
}

std::string thread_placement() {
  sched_param now{};
  // Asks the kernel, not the C library, which caches the values it set. Cannot fail for the calling thread.
  const int policy = ::sched_getscheduler(0);
  (void)::sched_getparam(0, &now);
  const std::string what = policy == SCHED_FIFO   ? "FIFO " + std::to_string(now.sched_priority)
                           : policy == SCHED_RR   ? "RR " + std::to_string(now.sched_priority)
                           : policy == SCHED_IDLE ? "idle"
                                                  : "ordinary";
  return what + " on CPU " + list_of(own_cpus());
}

}  // namespace ruffini
