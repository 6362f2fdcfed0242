// Deterministic simulation of device, host, line, camera, medium and power (tests/README.md).
//
//   ruffini_simulation --hours H [--first N]       device-hours from seed N on; ends at the first broken promise
//   ruffini_simulation --seed N [--log FILE]       one seed again, with what happened line by line
#include <CLI/CLI.hpp>
#include <cinttypes>
#include <cstdio>
#include <ctime>
#include <exception>
#include <fstream>
#include <optional>

#include "world.h"

namespace {

using ruffini::sim::Outcome;

constexpr double kHourUs = 3.6e9;

struct Arguments {
  std::optional<uint64_t> seed;
  uint64_t first = 1;
  double hours = 1;
  uint64_t chaos_s = 180;  // of each seed: long enough for some flashes, short enough for many mixes
  std::string log;
  bool is_json = false;
};

struct Sum {
  uint64_t n_seeds = 0;
  Outcome all;

  void add(const Outcome& one) {
    ++n_seeds;
    all.simulated_us += one.simulated_us;
    all.n_frames += one.n_frames;
    all.n_valid_forces += one.n_valid_forces;
    all.n_stale += one.n_stale;
    all.n_confirmed += one.n_confirmed;
    all.n_reverted += one.n_reverted;
    all.n_starts += one.n_starts;
    for (size_t i = 0; i < all.faults.size(); ++i) all.faults[i] += one.faults[i];
  }
};

void print(const Sum& sum, double seconds) {
  const double hours = static_cast<double>(sum.all.simulated_us) / kHourUs;
  std::printf("SIMULATED: %.1f device-hours, %" PRIu64 " seeds, in %.1f s of one core (%.0f times real time)\n", hours,
              sum.n_seeds, seconds, hours * 3'600 / seconds);
  std::printf("%" PRIu64 " starts, %" PRIu64 " frames, %" PRIu64 " valid forces sent, %" PRIu64 " stale ones, %" PRIu64
              " calibrations confirmed, %" PRIu64 " reverted\n",
              sum.all.n_starts, sum.all.n_frames, sum.all.n_valid_forces, sum.all.n_stale, sum.all.n_confirmed,
              sum.all.n_reverted);
  for (size_t i = 0; i < sum.all.faults.size(); ++i) {
    std::printf("%s%s %" PRIu64, i % 6 == 0 ? "\n  " : ", ", ruffini::sim::kFaultNames[i], sum.all.faults[i]);
  }
  std::printf("\n");
}

// For tests/ledger.py.
void print_json(const Sum& sum, uint64_t first) {
  std::printf("{\"first_seed\": %" PRIu64 ", \"seeds\": %" PRIu64 ", \"device_hours\": %.1f}\n", first, sum.n_seeds,
              static_cast<double>(sum.all.simulated_us) / kHourUs);
}

int run(const Arguments& given) {
  const ruffini::sim::TinySensor sensor;
  const std::clock_t start = std::clock();  // of the processor: the machine may have other work
  Sum sum;
  const uint64_t first = given.seed.value_or(given.first);
  for (uint64_t n = first;; ++n) {
    const Outcome one = ruffini::sim::simulate(sensor, n, given.chaos_s * 1'000'000, !given.log.empty());
    sum.add(one);
    if (!given.log.empty() && !(std::ofstream(given.log) << one.text).flush()) {
      std::fprintf(stderr, "%s: cannot be written\n", given.log.c_str());
      return 2;
    }
    if (!one.broken.empty()) {
      std::fprintf(stderr,
                   "BROKEN after %.6f s: %s\nagain: ruffini_simulation --seed %" PRIu64 " --chaos-s %" PRIu64
                   " --log events.txt\n",
                   static_cast<double>(one.at_us) / 1e6, one.broken.c_str(), n, given.chaos_s);
      return 1;
    }
    if (given.seed) std::printf("log %016" PRIx64 "\n", one.hash);
    if (given.seed || static_cast<double>(sum.all.simulated_us) >= given.hours * kHourUs) break;
  }
  if (given.is_json) {
    print_json(sum, first);
  } else {
    print(sum, static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Deterministic simulation. Exit codes: 0 ok, 1 a promise was broken, 2 usage"};
  Arguments given;
  app.add_option("--seed", given.seed, "this one alone");
  app.add_option("--first", given.first, "the first of several");
  app.add_option("--hours", given.hours, "simulated device-hours");
  app.add_option("--chaos-s", given.chaos_s, "seconds of each seed in which things go wrong");
  app.add_option("--log", given.log, "what happened, line by line (of the last seed)");
  app.add_flag("--json", given.is_json, "the figures alone, for a machine");
  try {
    app.parse(argc, argv);
    return run(given);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ruffini_simulation: %s\n", error.what());
    return 1;
  }
}
