// The calibrations on the medium, by generation:
//
//   calibration-7.safetensors   in force: the highest number
//   calibration-6.safetensors   previously in force; lower ones are removed
//   trial.safetensors           a new one that has not proved itself; removed at start, so a restart reverts to the old
//                               one
//   incoming.tmp                an incomplete upload; removed at start
//
// calibration-8.epoch-2.safetensors: from then on files of a lower security epoch are refused. The epoch is part of the
// name, so that the rename that puts a file in force also raises the epoch, atomically.
//
// Every transition is one rename. stage() turns a temporary file that is synced and read back from the medium into the
// trial, confirm() gives it the next number, and an undo gives the next number to the file before. No record beside the
// names could contradict them, and after any power cut the old or the new file is in force, complete:
// tests/cpp/store/crash_states_test.cpp visits every state that store/storage.h permits. Link thread only.
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
  // A file in force, identified by its name.
  struct Slot {
    uint64_t generation = 0;
    uint32_t epoch = 0;
    friend auto operator<=>(const Slot&, const Slot&) = default;
  };

  [[nodiscard]] static SlotStore open(std::unique_ptr<Storage> medium);
  // Opens a folder, and creates it if it is missing. Errors: kStorage with path and remedy.
  [[nodiscard]] static Result<SlotStore> open(const std::string& folder);

  // Returns the n-th newest file; an empty vector if there are fewer. Errors: kStorage, also for an empty file.
  [[nodiscard]] Result<std::vector<uint8_t>> load(size_t n = 0) const;
  // Puts `bytes` on trial, durably, replacing another trial. The file in force stays.
  [[nodiscard]] Status stage(std::span<const uint8_t> bytes);
  // Puts the trial and its security epoch in force, durably. Of the other files only the `before`-th newest remains,
  // for an undo. Precondition: there is a trial. An error with is_durable() false: only the sync has failed.
  [[nodiscard]] Status confirm(uint32_t epoch = 0, size_t before = 0);
  // Ends the trial; the file in force stays. Precondition: there is a trial.
  [[nodiscard]] Status reject();
  // Makes the names durable, where a call's own sync failed.
  [[nodiscard]] Status sync();
  // False: a sync has failed, and a power cut may put another file in force.
  [[nodiscard]] bool is_durable() const { return is_durable_; }
  // What that means, and why; empty if is_durable().
  [[nodiscard]] std::string unsynced() const;
  // True if open() found an unfinished trial and removed it.
  [[nodiscard]] bool has_discarded_trial() const { return has_discarded_trial_; }
  // Puts the n-th newest file in force, durably. A second call reverts the first. Precondition: there is such a file.
  // If neither its sync nor the way back succeeds, it is done, and is_durable() is false.
  [[nodiscard]] Status undo(size_t n = 1);
  // Highest security epoch reached; it never decreases.
  [[nodiscard]] Result<uint32_t> epoch() const;
  // Succeeds if a flash could be stored; otherwise returns the reason.
  [[nodiscard]] Status can_write() const;
  // Problem of the medium found by open(); empty: none.
  [[nodiscard]] const std::string& problem() const { return problem_; }

 private:
  explicit SlotStore(std::unique_ptr<Storage> medium) : medium_(std::move(medium)) {}
  [[nodiscard]] Result<std::vector<Slot>> slots() const;
  [[nodiscard]] Result<Slot> next_slot(const std::vector<Slot>& found, uint32_t epoch) const;
  [[nodiscard]] Status write_checked(std::span<const uint8_t> bytes);
  // Renames a calibration; durable from the next sync on.
  [[nodiscard]] Status rename(const std::string& from, const std::string& to);
  // Returns whether it was present.
  [[nodiscard]] Result<bool> remove_if_present(const std::string& name);

  std::unique_ptr<Storage> medium_;
  bool has_discarded_trial_ = false;
  bool is_durable_ = false;
  std::string sync_problem_;
  std::string problem_;
};

}  // namespace ruffini
