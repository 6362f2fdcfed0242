// What a calibration file says of its place in a device's history, and which may follow which (proto/CALIBRATION.md,
// "Which file may follow"). All of it is under the file's signature.
#pragma once

#include <cstdint>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

struct Manifest {
  int64_t version = 0;
  uint32_t epoch = 0;         // of security: a device that has reached one takes no file of a lower one again
  bool allows_older = false;  // the owner wants this file though a newer version is in force
  bool allows_jump = false;   // the owner wants this file though its numbers are far ahead
};

// A number that is far ahead is a mistake, or somebody who wants to lock out all files to come.
inline constexpr int64_t kMaxVersionStep = 1'000;
inline constexpr uint32_t kMaxEpochStep = 16;

// Errors: kBadInput where version or epoch is missing or no number.
[[nodiscard]] Result<Manifest> read_manifest(const Calibration& calibration);
// Whether it may be used at all by a device that has reached `epoch`. Errors: kRefused.
[[nodiscard]] Status check_epoch(const Manifest& manifest, uint32_t epoch);
// Whether it may be flashed there, where `version` is in force (0: nothing). Errors: kRefused.
[[nodiscard]] Status check_succession(const Manifest& manifest, int64_t version, uint32_t epoch);

}  // namespace ruffini
