// From uploaded bytes to a calibration in force: hash, layout, signature, target, bounds proof, then the medium, then
// the frame thread on trial, and in force for good once it has shown good frames. Until then a restart, an undo and
// the trial's failure go back to what was in force before. Link thread only.
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

  [[nodiscard]] bool is_unjudged() const { return is_present && gates != kPassed; }

  bool is_present = false;
  std::string sha256;
  std::string created_utc;
  std::string kinds;
  std::string gates;  // of its report: kPassed, what failed, or empty where nobody has judged it
  Signer signer;
  Manifest manifest;
  std::shared_ptr<const CalibrationFile> file;
};

// So many good frames (none of kWrongFlags) confirm a calibration, so many frames without them end it. 0: no trial.
struct TrialRule {
  uint16_t n_good = 32;
  uint16_t n_frames = 256;
};

// How a trial ended.
struct TrialEnd {
  bool is_confirmed = false;
  std::string text;  // for a person
};

class Calibrator {
 public:
  static constexpr uint64_t kMaxUploadBytes = uint64_t{128} << 20;
  static constexpr size_t kMaxChunkBytes = 3'072;

  Calibrator(const BoardSettings& board, std::string serial, SlotStore store, Exchange& exchange,
             TrialRule rule = TrialRule(), KeyRing keys = KeyRing());

  // The path for the calibration in force, where that is spoilt for the one before it, then for the factory's, else
  // without one; `problem` says why a stored file was not used, or what the medium cannot do.
  [[nodiscard]] Result<std::unique_ptr<FramePath>> start(ClockFunction clock, std::string& problem);
  // Without a calibration, though one may be stored: the last runs have crashed.
  [[nodiscard]] Result<std::unique_ptr<FramePath>> start_safe(ClockFunction clock, std::string& problem);

  // What is used where the medium has nothing that can be: of a read-only image. To be called before start().
  void set_factory(std::vector<uint8_t> file) { factory_ = std::move(file); }

  [[nodiscard]] Status begin(uint64_t size_bytes, const std::string& sha256);
  [[nodiscard]] Status chunk(uint64_t offset, std::span<const uint8_t> data);
  // On success the file is durable and handed to the frame thread, on trial where the rule wants one.
  [[nodiscard]] Status commit();
  void abort();
  // Puts in force what was so before the last commit, which ends its trial; once more takes that back.
  [[nodiscard]] Status undo();
  // The trial's end, once. To be called now and then.
  [[nodiscard]] std::optional<TrialEnd> poll();

  [[nodiscard]] uint64_t next_offset() const { return upload_.size(); }
  [[nodiscard]] bool is_receiving() const { return is_receiving_; }
  [[nodiscard]] bool is_complete() const { return is_receiving_ && upload_.size() == size_bytes_; }
  // What the frames are computed with.
  [[nodiscard]] const ActiveCalibration& active() const { return active_; }
  [[nodiscard]] bool is_on_trial() const { return is_on_trial_; }
  // Good frames of the trial so far, and how many are wanted.
  [[nodiscard]] PathTally tally() const;
  [[nodiscard]] const TrialRule& rule() const { return rule_; }
  [[nodiscard]] const KeyRing& keys() const { return keys_; }
  // Why the last trial ended without success, or stored files are not used; empty: nothing to say.
  [[nodiscard]] const std::string& problem() const { return problem_; }

 private:
  struct Prepared {
    std::unique_ptr<FramePath> path;
    ActiveCalibration calibration;
  };
  // Whatever is used passes here: layout, signature, target, security epoch, bounds proof.
  [[nodiscard]] Result<Prepared> prepare(std::span<const uint8_t> bytes) const;
  // For the newest stored file that is sound, or for none; what is wrong with others goes to `problem_`.
  [[nodiscard]] Prepared prepare_stored();
  void put_in_force(Prepared prepared);
  [[nodiscard]] TrialEnd confirm();
  // Goes back to what is in force on the medium.
  void revert();

  BoardSettings board_;
  std::string serial_;
  SlotStore store_;
  Exchange& exchange_;
  TrialRule rule_;
  KeyRing keys_;
  std::vector<uint8_t> factory_;
  bool is_on_trial_ = false;
  size_t nth_in_force_ = 0;  // of the stored files, newest first: an undo goes back to it while another is on trial
  std::string problem_;
  ClockFunction clock_ = nullptr;
  ActiveCalibration active_;
  bool is_receiving_ = false;
  uint64_t size_bytes_ = 0;
  std::string expected_sha256_;
  std::vector<uint8_t> upload_;
};

}  // namespace ruffini
