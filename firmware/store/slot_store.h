// The calibrations on the medium, by generation:
//
//   calibration-7.safetensors   in force: the highest number
//   calibration-6.safetensors   what was in force before; lower ones go
//   trial.safetensors           a new one that has yet to show that it measures; removed at start, so a restart goes back
//   incoming.tmp                an upload that is not finished; removed at start
//
// calibration-8.epoch-2.safetensors: from then on no file of a lower security epoch counts. The name carries it, so that
// the rename that puts a file in force raises the epoch, or does neither.
//
// One rename decides. stage() makes the trial of a temporary file that is synced and read back from the medium,
// confirm() gives it the next number; an undo gives that to the file before. So there is no record beside the names that
// could contradict them, and after any power cut the old or the new file is in force, whole:
// tests/cpp/store/crash_states_test.cpp visits every state that store/storage.h allows. Link thread only.
#pragma once

#include <compare>
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
  // A file in force: by its name.
  struct Slot {
    uint64_t generation = 0;
    uint32_t epoch = 0;
    friend auto operator<=>(const Slot&, const Slot&) = default;
  };

  [[nodiscard]] static SlotStore open(std::unique_ptr<Storage> medium);
  // A folder, created where it is missing. Errors: kStorage with path and remedy.
  [[nodiscard]] static Result<SlotStore> open(const std::string& folder);

  // The n-th newest file; an empty vector where there are not so many. Errors: kStorage, also of a file without content.
  [[nodiscard]] Result<std::vector<uint8_t>> load(size_t n = 0) const;
  // Puts `bytes` on trial, durably; what is in force stays so. In the place of another one on trial.
  [[nodiscard]] Status stage(std::span<const uint8_t> bytes);
  // What is on trial is in force from now on, durably, and with it its security epoch. Of the other files only the
  // `before`-th newest stays, what an undo goes back to. Precondition: there is one on trial.
  [[nodiscard]] Status confirm(uint32_t epoch = 0, size_t before = 0);
  // Ends the trial; what is in force stays so. Precondition: there is one.
  [[nodiscard]] Status reject();
  // When the store was opened it found a trial that had not ended, and removed it.
  [[nodiscard]] bool has_lost_trial() const { return has_lost_trial_; }
  // Puts the n-th newest file in force, durably; once more takes that back. Precondition: there is one.
  [[nodiscard]] Status undo(size_t n = 1);
  // The security epoch that was reached; it never falls.
  [[nodiscard]] Result<uint32_t> epoch() const;
  // Whether a flash could be kept; else why not.
  [[nodiscard]] Status can_write() const;
  // What was wrong with the medium at open(); empty: nothing.
  [[nodiscard]] const std::string& problem() const { return problem_; }

 private:
  explicit SlotStore(std::unique_ptr<Storage> medium) : medium_(std::move(medium)) {}
  [[nodiscard]] Result<std::vector<Slot>> slots() const;
  [[nodiscard]] Result<Slot> next_slot(const std::vector<Slot>& found, uint32_t epoch) const;
  [[nodiscard]] Status write_checked(std::span<const uint8_t> bytes);
  // Whether it was there.
  [[nodiscard]] Result<bool> remove_if_there(const std::string& name);

  std::unique_ptr<Storage> medium_;
  bool has_lost_trial_ = false;
  std::string problem_;
};

}  // namespace ruffini
