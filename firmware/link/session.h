// The device's side of the conversation: commands in, replies and telemetry out.
//
// Link thread only. Replies wait (at most 64 messages); of telemetry the newest message of each type wins,
// and what it replaces is counted. Bytes are written as the line takes them; a frame that was begun is finished first.
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
};

class Session {
 public:
  Session(const BoardSettings& board, const FramePath& path, DeviceIdentity identity, Calibrator& calibrator,
          Exchange& exchange, const SessionSeams& seams);

  void receive(std::span<const uint8_t> bytes);
  // Takes telemetry from the ring, deletes retired paths, sends STATUS when asked, once a second to subscribers.
  void poll(uint64_t now_us);
  // Bytes to write next; consumed(n) after n of them went out.
  [[nodiscard]] std::span<const uint8_t> pending();
  void consumed(size_t n_bytes);
  // The line was lost: forget what was half written, and who subscribed.
  void reset_line();
  // Everything that was to be sent is sent.
  [[nodiscard]] bool is_drained();

 private:
  struct Outgoing {
    std::vector<uint8_t> bytes;
    bool is_full = false;
    bool is_bare = false;  // the session's own: no frames yet
    uint64_t order = 0;
  };

  // Of the session's own: its frames are made when it goes out.
  struct Waiting {
    ruffini_MessageType type;
    std::vector<uint8_t> payload;
  };

  void handle(const WireFrame& frame);
  [[nodiscard]] uint64_t n_damaged() const;
  void ask_again();
  void signed_command(const WireFrame& frame);
  void command(const ruffini_Command& command, uint8_t sensor, const Status& allowed);
  // Where the command changes something: signed, if that is asked for, and by the host that has the lease.
  [[nodiscard]] Status may(const ruffini_Command& command, bool is_signed);
  [[nodiscard]] bool is_repeat(const ruffini_Command& command) const;
  [[nodiscard]] static bool is_remembered(const ruffini_Command& command);
  void lease(const ruffini_Command& command, ruffini_Reply& reply);
  void read_back(const ruffini_FlashRead& request, ruffini_Reply& reply) const;
  void answer_time(const WireFrame& frame);
  void act(const ruffini_Command& command, ruffini_Reply& reply);
  void flash(const ruffini_Command& command, ruffini_Reply& reply);
  void say_trial(ruffini_Reply& reply) const;
  void subscribe(const ruffini_Subscribe& request);
  void send_hello();
  void send_schema();
  void send_status(uint64_t now_us);
  void send_event(uint64_t now_us, ruffini_Event_Severity severity, const char* what, const std::string& text);
  // The camera stands still: an event, and the last wrench again, marked and invalid, ten times a second.
  void watch_camera(uint64_t now_us);
  void give_up_zero(uint64_t now_us);
  void watch_zero(uint64_t now_us);
  void send_stale_wrench();
  void tell_network(ruffini_Status& m) const;
  void tell_last_run(ruffini_Status& m) const;
  void tell_health(ruffini_Status& m, uint64_t n_frames);
  void send(ruffini_MessageType type, const pb_msgdesc_t* fields, const void* message);
  [[nodiscard]] static std::vector<uint8_t> serialised(const pb_msgdesc_t* fields, const void* message);
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
  bool has_asked_again_ = false;
  uint32_t sequence_ = 0;
  uint32_t last_request_id_ = 0;
  uint32_t last_holder_ = 0;
  bool has_last_reply_ = false;
  ruffini_Reply last_reply_{};
  StallWatch stall_;
  bool is_stalled_ = false;
  bool has_given_up_zero_ = false;  // in this stall
  uint32_t refused_zeros_ = 0;
  uint64_t stale_us_ = 0;  // of the last stale wrench
  uint64_t started_us_ = 0;
  bool is_status_asked_ = false;
  uint64_t status_us_ = 0;  // of the last one
  uint64_t status_frames_ = 0;
  uint64_t status_late_ = 0;
  uint64_t bytes_sent_ = 0;
  uint64_t status_bytes_ = 0;
  std::deque<Waiting> replies_;
  std::array<Outgoing, kMessageTypes> telemetry_;
  uint64_t order_ = 0;
  uint64_t received_us_ = 0;  // when the bytes came that are being handled
  uint64_t n_replaced_ = 0;   // telemetry, by a newer message of its type
  uint64_t n_down_ = 0;       // messages that waited when the line was lost
  uint64_t n_cut_ = 0;        // frames that it cut off
  std::vector<uint8_t> popped_;
  std::vector<uint8_t> writing_;
  Outgoing* offered_ = nullptr;  // by the last pending(); nullptr: a reply, or nothing
  size_t written_ = 0;           // of `writing_`; 0: nothing was begun
};

}  // namespace ruffini
