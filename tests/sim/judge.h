// What must hold at every step of a simulation. Each broken promise is a Failure.
//
// It looks at the device from outside, by what goes over the line (through a codec of its own), and from inside, by which
// calibration is in force and what the counters say.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "event_log.h"
#include "link/calibrator.h"
#include "link/exchange.h"
#include "reference_codec.h"
#include "ruffini.pb.h"
#include "sim_camera.h"
#include "sim_disk.h"
#include "tiny_sensor.h"

namespace ruffini::sim {

class Judge {
 public:
  Judge(const TinySensor& sensor, Disk& disk, EventLog& log, const uint64_t& now_us)
      : sensor_(sensor), disk_(disk), log_(log), now_us_(now_us) {}

  // A device was started: on what, and why not on what it should.
  void booted(const Calibrator& calibrator, const Exchange& exchange, const SimCamera& camera,
              const std::string& problem);
  // It is gone; with `in_store` in the middle of a call to the medium.
  void stopped(bool in_store);

  void sent(std::span<const uint8_t> bytes);
  void received(std::span<const uint8_t> bytes);
  void before_serving();
  void after_serving(bool is_line_up, bool has_room);
  void after_capture(bool is_mailbox_full);
  void after_frame();
  // A host that starts may count its requests from any number.
  void host_restarted();

  [[nodiscard]] uint64_t n_valid_forces() const { return n_valid_; }
  [[nodiscard]] uint64_t n_stale() const { return n_stale_; }
  [[nodiscard]] uint64_t n_confirmed() const { return n_confirmed_; }
  [[nodiscard]] uint64_t n_reverted() const { return n_reverted_; }

 private:
  // What the device computes with: empty hash: nothing.
  struct Truth {
    std::string sha256;
    bool is_on_trial = false;
    bool operator==(const Truth&) const = default;
  };
  struct Owed {
    uint32_t request_id = 0;
    uint64_t at_us = 0;
  };

  [[nodiscard]] Truth truth() const { return {calibrator_->active().sha256, calibrator_->is_on_trial()}; }
  void observe();
  void changed(const Truth& before, const Truth& after);
  void trial_ended(const Truth& before, const Truth& after);
  [[nodiscard]] bool was_asked(pb_size_t action) const;
  [[nodiscard]] bool ran(pb_size_t action);
  void check_sequence(const ReferenceFrame& frame);
  void check_wrench(const ReferenceFrame& frame);
  void check_reply(const ReferenceFrame& frame);
  [[nodiscard]] bool is_kept(const std::string& hash) const;
  void check_status(const ReferenceFrame& frame);
  void check_counters();
  void check_drops();

  const TinySensor& sensor_;
  Disk& disk_;
  EventLog& log_;
  const uint64_t& now_us_;
  const Calibrator* calibrator_ = nullptr;  // while a device runs
  const Exchange* exchange_ = nullptr;
  const SimCamera* camera_ = nullptr;

  // The store: what must be in force after a restart, and what an undo brings back. Without a value: not known.
  std::optional<std::string> now_ = "";
  std::optional<std::string> before_ = "";
  Truth seen_;
  std::set<std::string> used_;               // since the start
  std::map<std::string, uint64_t> sure_us_;  // when it was last in force for good
  std::string tried_over_;                   // what was in force when the trial began
  uint64_t trial_frames_ = 0;
  uint64_t trial_good_ = 0;

  // The line.
  ReferenceDecoder from_device_;
  ReferenceDecoder to_device_;
  std::map<uint8_t, uint32_t> sequence_;               // by sensor
  std::map<uint32_t, std::string> queried_;            // by request
  std::map<uint32_t, uint64_t> delivered_;             // requests that reached the device, when first
  std::map<uint32_t, uint64_t> former_;                // those of hosts before: their replies may still come
  std::vector<std::pair<uint32_t, pb_size_t>> asked_;  // requests of this step with what they ask for
  std::set<uint32_t> run_;                             // requests whose work was seen
  std::deque<Owed> owed_;
  uint64_t blocked_us_ = 0;
  int zero_before_ = -1;

  // Telemetry of the sensor: encoded = sent + dropped + lost with the line + waiting.
  int64_t n_encoded_ = 0;
  int64_t n_sent_ = 0;
  int64_t n_lost_ = 0;
  int64_t n_stalled_steps_ = 0;  // in each of them a stale wrench may have been dropped, which no frame made
  uint64_t n_valid_ = 0;
  uint64_t n_stale_ = 0;
  uint64_t n_confirmed_ = 0;
  uint64_t n_reverted_ = 0;
  bool is_mailbox_full_ = false;
  uint64_t processed_us_ = 0;  // when the last frame was
};

}  // namespace ruffini::sim
