// A host by proto/README.md: asks, repeats what was not answered, goes on where it was after an unplug.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "dice.h"
#include "event_log.h"
#include "faults.h"
#include "judge.h"
#include "reference_codec.h"
#include "ruffini.pb.h"
#include "sim_line.h"
#include "tiny_sensor.h"

namespace ruffini::sim {

class Host {
 public:
  Host(const TinySensor& sensor, Dice dice, Swarm& swarm, SimLine& line, Judge& judge, EventLog& log,
       const uint64_t& now_us)
      : sensor_(sensor), dice_(dice), swarm_(swarm), line_(line), judge_(judge), log_(log), now_us_(now_us) {}

  // Reads what has come, sends what is due; returns when it wants to be called again at the latest.
  uint64_t step();
  // Nothing may touch the sensor: it was told, or may yet be, to learn its rest.
  [[nodiscard]] bool keeps_hands_off() const { return now_us_ < hands_off_until_us_; }

  // For the end, when nothing goes wrong any more: flashes this one next.
  void flash_now(const Table& table);
  // The table of that flash, once the device has said that it is in force for good.
  [[nodiscard]] bool has_flashed() const { return has_flashed_; }
  [[nodiscard]] uint64_t n_fresh_forces() const { return n_fresh_forces_; }
  [[nodiscard]] bool is_greeted() const { return stage_ != Stage::kClosed && stage_ != Stage::kHello; }
  [[nodiscard]] uint64_t n_flashed() const { return n_flashed_; }
  [[nodiscard]] const std::string& in_force() const { return in_force_; }

 private:
  enum class Stage { kClosed, kHello, kSubscribe, kIdle, kBegin, kChunk, kCommit, kQuery, kPause, kOther };

  void open();
  void greet();
  void read();
  void take(const ReferenceFrame& frame);
  void replied(const ruffini_Reply& reply);
  void greeted(const ruffini_Hello& hello);
  void next_job();
  void go_on();
  void begin();
  void send_chunk();
  void query();
  void flash_ended();
  void ask(const ruffini_Command& command, Stage stage, uint64_t wait_us, uint64_t tries);
  void send_again();
  void write(uint8_t type, std::span<const uint8_t> payload);
  void flood();
  [[nodiscard]] static ruffini_Command command(pb_size_t action);

  const TinySensor& sensor_;
  Dice dice_;
  Swarm& swarm_;
  SimLine& line_;
  Judge& judge_;
  EventLog& log_;
  const uint64_t& now_us_;

  ReferenceDecoder decoder_;
  Stage stage_ = Stage::kClosed;
  uint64_t due_us_ = 0;
  uint64_t reads_from_us_ = 0;
  uint64_t hands_off_until_us_ = 0;
  bool wants_zero_ = false;
  uint32_t sequence_ = 0;
  uint32_t request_id_ = 1;
  uint32_t holder_ = 0;
  Bytes asked_;  // the last command, serialize_message
  uint64_t wait_us_ = 0;
  uint64_t tries_ = 0;
  uint64_t chunk_bytes_ = 0;
  uint64_t flash_until_us_ = 0;
  const Table* table_ = nullptr;  // being flashed
  bool is_wanted_ = false;        // by flash_now
  bool has_flashed_ = false;
  std::string in_force_;
  uint64_t n_fresh_forces_ = 0;
  uint64_t n_flashed_ = 0;
};

}  // namespace ruffini::sim
