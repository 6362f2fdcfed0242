// One sensor's life on a virtual clock: device, host, line, camera, medium and power, in one thread, from one seed.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "daemon.h"
#include "host.h"
#include "judge.h"
#include "sim_camera.h"
#include "sim_disk.h"
#include "sim_line.h"
#include "tiny_sensor.h"

namespace ruffini::sim {

struct Outcome {
  std::string broken;  // the promise that was; empty: none
  uint64_t at_us = 0;
  uint64_t hash = 0;  // of the event log
  std::string text;
  uint64_t simulated_us = 0;
  uint64_t n_frames = 0;
  uint64_t n_valid_forces = 0;
  uint64_t n_stale = 0;
  uint64_t n_confirmed = 0;
  uint64_t n_reverted = 0;
  uint64_t n_starts = 0;
  std::array<uint64_t, kFaults> faults{};
};

// Chaos for so long; then nothing goes wrong any more, and the device must recover.
[[nodiscard]] Outcome simulate(const TinySensor& sensor, uint64_t seed, uint64_t chaos_us, bool keeps_text);

}  // namespace ruffini::sim
