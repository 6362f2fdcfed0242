// The calibrations on the medium, by generation:
//
//   calibration-7.safetensors   in force: the highest number
//   calibration-6.safetensors   what was in force before; lower ones go
//   incoming.tmp                an upload that is not finished; removed at start
//
// One rename decides. An install gives the next number to a temporary file that is synced and read back from the medium;
// an undo gives it to the file before. So there is no record beside the names that could contradict them, and after
// any power cut the old or the new file is in force, whole: tests/cpp/store/crash_states_test.cpp visits every state
// that store/storage.h allows. Link thread only.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "store/storage.h"

namespace ruffini {

class SlotStore {
 public:
  // Errors: kStorage with path and remedy.
  [[nodiscard]] static Result<SlotStore> open(std::unique_ptr<Storage> medium);
  // A folder, created where it is missing.
  [[nodiscard]] static Result<SlotStore> open(const std::string& folder);

  // The file in force; an empty vector where there is none.
  [[nodiscard]] Result<std::vector<uint8_t>> load() const { return load_nth(0); }
  // What was in force before it; an empty vector where there was nothing.
  [[nodiscard]] Result<std::vector<uint8_t>> load_previous() const { return load_nth(1); }
  // Makes `bytes` the file in force, durably.
  [[nodiscard]] Status install(std::span<const uint8_t> bytes);
  // Puts in force what was so before, durably; once more takes that back. Precondition: there is one.
  [[nodiscard]] Status undo();

 private:
  explicit SlotStore(std::unique_ptr<Storage> medium) : medium_(std::move(medium)) {}
  [[nodiscard]] Result<std::vector<uint64_t>> generations() const;
  [[nodiscard]] Result<std::vector<uint8_t>> load_nth(size_t n) const;
  [[nodiscard]] Status write_checked(std::span<const uint8_t> bytes);
  [[nodiscard]] Status remove_incoming();

  std::unique_ptr<Storage> medium_;
};

}  // namespace ruffini
