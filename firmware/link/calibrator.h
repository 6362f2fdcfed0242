// Turns uploaded bytes into the calibration in force: checks hash, layout, signature, target and bounds, writes the
// file to the medium, gives it to the frame thread on trial, and confirms it after enough good frames. Until then a
// restart, an undo or a failed trial restores the previous calibration. Link thread only.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "board/settings.h"
#include "link/exchange.h"
#include "store/manifest.h"
#include "store/signature.h"
#include "store/slot_store.h"

namespace ruffini {

struct ActiveCalibration {
  static constexpr char kPassed[] = "passed";

  [[nodiscard]] bool lacks_passed_gates() const { return is_present && gates != kPassed; }

  bool is_present = false;
  std::string sha256;
  std::string created_utc;
  std::string kinds;
  std::string gates;  // of its report: kPassed, the failed ones, or empty if it was never judged
  Signer signer;
  Manifest manifest;
  std::shared_ptr<const CalibrationFile> file;
};

// Number of good frames (none of kWrongFlags) that confirm a calibration, and of frames after which an unconfirmed
// trial ends. 0: no trial.
struct TrialRule {
  uint16_t n_good = 32;
  uint16_t n_frames = 256;
};

// How a trial ended.
struct TrialEnd {
  bool is_confirmed = false;  // in force, and durable
  bool is_in_force = false;   // maybe not after a power cut
  std::string text;           // for people
};

class Calibrator {
 public:
  static constexpr uint64_t kMaxUploadBytes = uint64_t{128} << 20;
  static constexpr size_t kMaxChunkBytes = 3'072;

  Calibrator(const BoardSettings& board, std::string serial, SlotStore store, Exchange& exchange,
             TrialRule rule = TrialRule(), KeyRing keys = KeyRing());

  // Creates the path for the calibration in force; if that is damaged, for the previous one, then for the factory's,
  // else for none. `problem`: why a stored file was not used, or what the medium cannot do.
  [[nodiscard]] Result<std::unique_ptr<FramePath>> start(ClockFunction clock, std::string& problem);
  // Starts without the stored calibration, after repeated crashes.
  [[nodiscard]] Result<std::unique_ptr<FramePath>> start_safe(ClockFunction clock, std::string& problem);

  // Fallback if the medium has no usable file, e.g. from a read-only image. Call before start().
  void set_factory(std::vector<uint8_t> file) { factory_ = std::move(file); }

  [[nodiscard]] Status begin(uint64_t size_bytes, const std::string& sha256);
  [[nodiscard]] Status chunk(uint64_t offset, std::span<const uint8_t> data);
  // On success the file is durable and with the frame thread, on trial if the rule demands one.
  [[nodiscard]] Status commit();
  void abort();
  // Restores the calibration before the last commit and ends its trial. A second call reverts the first.
  [[nodiscard]] Status undo();
  // Returns the end of the trial once. Call regularly.
  [[nodiscard]] std::optional<TrialEnd> poll();
  // False: the medium failed when it was to keep what was done last; a power cut may put another calibration in force.
  [[nodiscard]] bool is_durable() const { return store_.is_durable(); }
  // Tries again to keep it. Call until is_durable().
  [[nodiscard]] Status make_durable() { return store_.sync(); }

  [[nodiscard]] uint64_t next_offset() const { return upload_.size(); }
  [[nodiscard]] bool is_receiving() const { return is_receiving_; }
  [[nodiscard]] bool is_complete() const { return is_receiving_ && upload_.size() == size_bytes_; }
  // The calibration that frames are computed with.
  [[nodiscard]] const ActiveCalibration& active() const { return active_; }
  [[nodiscard]] bool is_on_trial() const { return is_on_trial_; }
  // Number of good frames in the trial, and how many it needs.
  [[nodiscard]] PathTally tally() const;
  [[nodiscard]] const TrialRule& rule() const { return rule_; }
  [[nodiscard]] const KeyRing& keys() const { return keys_; }
  // Why the last trial failed, why stored files are not used, or what a power cut may undo; empty: no problem.
  [[nodiscard]] std::string problem() const;

 private:
  struct Prepared {
    std::unique_ptr<FramePath> path;
    ActiveCalibration calibration;
  };
  // Every file must pass this check: layout, signature, target, security epoch, bounds.
  [[nodiscard]] Result<Prepared> prepare(std::vector<uint8_t> bytes) const;
  // Prepares the newest usable stored file, or none; problems of the others go to `problem_`.
  [[nodiscard]] Prepared prepare_stored();
  void activate(Prepared prepared);
  [[nodiscard]] TrialEnd confirm();
  // Returns to the calibration in force on the medium.
  void revert();

  BoardSettings board_;
  std::string serial_;
  SlotStore store_;
  Exchange& exchange_;
  TrialRule rule_;
  KeyRing keys_;
  std::vector<uint8_t> factory_;
  bool is_on_trial_ = false;
  size_t active_index_ = 0;  // index among the stored files, newest first: an undo during a trial returns to it
  std::string problem_;
  ClockFunction clock_ = nullptr;
  ActiveCalibration active_;
  bool is_receiving_ = false;
  uint64_t size_bytes_ = 0;
  std::string expected_sha256_;
  std::vector<uint8_t> upload_;
};

}  // namespace ruffini
