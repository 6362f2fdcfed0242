// Version data of a calibration file, and the rules for which file may follow another (proto/CALIBRATION.md, "Which
// file may follow"). The signature covers all of it.
#pragma once

#include <cstdint>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

struct Manifest {
  int64_t version = 0;
  uint32_t epoch = 0;         // security epoch: a device that has reached one refuses files of lower ones
  bool allows_older = false;  // the owner permits this file although a newer version is in force
  bool allows_jump = false;   // the owner permits this file although its numbers are far ahead
};

// A larger step is a mistake, or an attempt to lock out all later files.
inline constexpr int64_t kMaxVersionStep = 1'000;
inline constexpr uint32_t kMaxEpochStep = 16;

// Returns kBadInput if version or epoch is missing or not a number.
[[nodiscard]] Result<Manifest> read_manifest(const Calibration& calibration);
// Checks that a device which has reached `epoch` may use the file. Errors: kRefused.
[[nodiscard]] Status check_epoch(const Manifest& manifest, uint32_t epoch);
// Checks that the file may be flashed while `version` is in force (0: nothing). Errors: kRefused.
[[nodiscard]] Status check_succession(const Manifest& manifest, int64_t version, uint32_t epoch);

}  // namespace ruffini
