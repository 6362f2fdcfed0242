// The device's side of the protocol: receives commands, sends replies and telemetry.
//
// Link thread only. Replies are queued (at most 64 messages). Of telemetry the newest message of each type is sent, and
// replaced ones are counted. Bytes are written as fast as the line accepts them; a frame that was begun is completed
// first.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <span>
#include <string>
#include <vector>

#include "link/access.h"
#include "link/calibrator.h"
#include "link/exchange.h"
#include "link/frame_codec.h"
#include "link/line_latency.h"
#include "link/stall_watch.h"
#include "ruffini.pb.h"
#include "store/last_run.h"

namespace ruffini {

inline constexpr uint8_t kDeviceSensor = 255;  // in packets about the device itself

struct DeviceIdentity {
  std::string serial;
  std::string version;
  uint32_t session_id = 0;
  uint8_t sensor = 0;
  uint8_t stream_flags = 0;  // FrameFlag: simulated, replay
  bool is_lossless = false;  // lockstep: telemetry waits instead of being replaced
  std::optional<LastRun> last_run{};
  bool is_safe_mode = false;
  bool is_memory_locked = false;  // no page of the daemon leaves memory
};

class Session {
 public:
  Session(const BoardSettings& board, const FramePath& path, DeviceIdentity identity, Calibrator& calibrator,
          Exchange& exchange, const SessionSeams& seams);

  void receive(std::span<const uint8_t> bytes);
  // Takes telemetry from the ring, deletes retired paths, and sends STATUS on request and once a second to subscribers.
  void poll(uint64_t now_us);
  // Bytes to write next; call consumed(n) after n of them were written.
  [[nodiscard]] std::span<const uint8_t> pending();
  void consumed(size_t n_bytes);
  // Resets after a hang-up: discards partly written data and subscriptions.
  void reset_line();
  // True if everything queued has been sent.
  [[nodiscard]] bool is_drained();

 private:
  struct Outgoing {
    std::vector<uint8_t> bytes;
    bool is_full = false;
    bool needs_framing = false;  // created by the session: not split into frames yet
    uint64_t order = 0;
    uint64_t exposed_us = 0;  // TelemetryHead
  };

  // Message created by the session. It is split into frames when it is sent.
  struct QueuedMessage {
    ruffini_MessageType type;
    std::vector<uint8_t> payload;
  };

  void handle(const WireFrame& frame);
  [[nodiscard]] uint64_t n_damaged() const;
  void request_retransmission();
  void signed_command(const WireFrame& frame);
  void command(const ruffini_Command& command, uint8_t sensor, const Status& allowed);
  // Commands that change something must be signed, if keys are enrolled, and come from the holder of the lease.
  [[nodiscard]] Status authorize(const ruffini_Command& command, bool is_signed);
  [[nodiscard]] bool is_repeat(const ruffini_Command& command) const;
  [[nodiscard]] static bool is_remembered(const ruffini_Command& command);
  void lease(const ruffini_Command& command, ruffini_Reply& reply);
  void read_back(const ruffini_FlashRead& request, ruffini_Reply& reply) const;
  void answer_time(const WireFrame& frame);
  void execute(const ruffini_Command& command, ruffini_Reply& reply);
  void flash(const ruffini_Command& command, ruffini_Reply& reply);
  void report_trial(ruffini_Reply& reply) const;
  void subscribe(const ruffini_Subscribe& request);
  void send_hello();
  void send_schema();
  void send_status(uint64_t now_us);
  void send_event(uint64_t now_us, ruffini_Event_Severity severity, const char* what, const std::string& text);
  // If the camera stalls: sends an event, and repeats the last wrench, marked stale and invalid, ten times a second.
  void watch_camera(uint64_t now_us);
  void cancel_zero(uint64_t now_us);
  void watch_zero(uint64_t now_us);
  void watch_rate(uint64_t now_us);
  void send_stale_wrench();
  void report_network(ruffini_Status& m) const;
  void report_last_run(ruffini_Status& m) const;
  void report_health(ruffini_Status& m, uint64_t n_frames);
  void report_latency(ruffini_Status& m) const;
  void send(ruffini_MessageType type, const pb_msgdesc_t* fields, const void* message);
  [[nodiscard]] static std::vector<uint8_t> serialize_message(const pb_msgdesc_t* fields, const void* message);
  void frame(ruffini_MessageType type, std::span<const uint8_t> payload);
  void begin_writing();
  [[nodiscard]] Outgoing& newest(uint8_t type);
  void take_telemetry();

  BoardSettings board_;
  DeviceIdentity identity_;
  Calibrator& calibrator_;
  Exchange& exchange_;
  const Clock& clock_;
  Access access_;
  GridSize grid_;
  NodeRange first_x_;
  NodeRange first_y_;
  FrameDecoder decoder_;
  uint64_t rx_malformed_ = 0;
  uint64_t rx_echo_ = 0;
  bool has_requested_retransmission_ = false;
  uint32_t sequence_ = 0;
  uint32_t last_request_id_ = 0;
  uint32_t last_holder_ = 0;
  bool has_last_reply_ = false;
  ruffini_Reply last_reply_{};
  StallWatch stall_;
  bool is_stalled_ = false;
  bool has_cancelled_zero_ = false;  // during this stall
  uint32_t refused_zeros_ = 0;
  uint32_t rate_divisor_ = 1;  // last reported
  uint64_t stale_us_ = 0;      // time of the last stale wrench
  uint64_t started_us_ = 0;
  bool is_status_requested_ = false;
  uint64_t sync_us_ = 0;    // time of the last attempt to make the calibration durable
  uint64_t status_us_ = 0;  // time of the last one
  uint64_t status_frames_ = 0;
  uint64_t status_late_ = 0;
  uint64_t bytes_sent_ = 0;
  uint64_t status_bytes_ = 0;
  std::deque<QueuedMessage> replies_;
  std::array<Outgoing, kMessageTypes> telemetry_;
  uint64_t order_ = 0;
  uint64_t received_us_ = 0;           // arrival time of the bytes being handled
  uint64_t n_replaced_ = 0;            // telemetry replaced by a newer message of its type
  uint64_t n_unsent_ = 0;              // replies and events for which the queue had no room
  uint64_t n_dropped_on_hang_up_ = 0;  // messages that were queued when the line was lost
  uint64_t n_truncated_ = 0;           // frames truncated by a hang-up
  std::vector<uint8_t> writing_;
  Outgoing* offered_ = nullptr;  // returned by the last pending(); nullptr: a reply, or nothing
  size_t written_ = 0;           // of `writing_`; 0: no frame has been begun
  uint64_t exposed_us_ = 0;      // of `writing_`, as in TelemetryHead
  LineLatency latency_;          // since the last subscription
};

}  // namespace ruffini
