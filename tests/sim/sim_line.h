// The line between device and host: two queues of pieces with all that befalls them.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <span>
#include <vector>

#include "dice.h"
#include "event_log.h"
#include "faults.h"
#include "link/link.h"

namespace ruffini::sim {

class SimLine {
 public:
  using Tap = std::function<void(std::span<const uint8_t>)>;

  SimLine(Dice dice, Swarm& swarm, EventLog& log, const uint64_t& now_us);

  // The device's end. `on_sent`: what the device wrote; `on_received`: what it is given.
  int device_read(std::span<uint8_t> out);
  int device_write(std::span<const uint8_t> bytes);
  bool device_open();
  void device_close() { is_open_ = false; }
  Tap on_sent = [](std::span<const uint8_t>) {};
  Tap on_received = [](std::span<const uint8_t>) {};

  // The host's end.
  void host_write(std::span<const uint8_t> bytes);
  [[nodiscard]] std::vector<uint8_t> host_read(size_t at_most);
  void connect() { is_connected_ = true; }
  void hang_up();
  [[nodiscard]] bool is_connected() const { return is_connected_; }

  // UINT64_MAX: nothing is on its way.
  [[nodiscard]] uint64_t next_for_device_us() const { return down_.empty() ? UINT64_MAX : down_.front().at_us; }
  [[nodiscard]] uint64_t next_for_host_us() const { return up_.empty() ? UINT64_MAX : up_.front().at_us; }
  [[nodiscard]] bool has_room() const { return n_up_ < kRoomBytes; }
  [[nodiscard]] bool has_unsent() const { return n_up_ > 0; }

 private:
  struct Piece {
    uint64_t at_us = 0;
    std::vector<uint8_t> bytes;
  };
  static constexpr size_t kPieceBytes = 512;    // of USB
  static constexpr size_t kRoomBytes = 17'588;  // of a pty of Linux
  static constexpr size_t kMaxDown = 64 << 10;  // what a host may have on its way

  void send(std::deque<Piece>& queue, std::span<const uint8_t> bytes);

  Dice dice_;
  Swarm& swarm_;
  EventLog& log_;
  const uint64_t& now_us_;
  std::deque<Piece> up_;
  std::deque<Piece> down_;
  size_t n_up_ = 0;
  size_t n_dropped_on_hang_up_ = 0;
  bool is_connected_ = false;  // a host holds it
  bool is_open_ = false;       // the device does
};

// What the daemon holds.
class LineEnd final : public Link {
 public:
  explicit LineEnd(SimLine& line) : line_(line) {}
  int read(std::span<uint8_t> out) override { return line_.device_read(out); }
  int write(std::span<const uint8_t> bytes) override { return line_.device_write(bytes); }
  void wait(bool /*is_writing*/, int /*timeout_ms*/) override {}
  [[nodiscard]] bool has_unsent() const override { return line_.has_unsent(); }
  bool reopen() override { return line_.device_open(); }

 private:
  SimLine& line_;
};

}  // namespace ruffini::sim
