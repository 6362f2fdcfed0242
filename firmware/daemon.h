// Threads of ruffinid: capture -> frame -> link, and one beside them for a learned network if the board has one.
// Each thread repeats one step; tests/sim runs the same steps on a virtual clock. With [pipeline] cores = 2 there are
// two frame threads, the second of which ends the frames (segment_turns.h).
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "base/clock.h"
#include "base/mailbox.h"
#include "base/random.h"
#include "base/turnstile.h"
#include "capture/camera.h"
#include "capture/frame_order.h"
#include "capture/rate_governor.h"
#include "frame_reflex.h"
#include "hw/board_io.h"
#include "hw/liveness.h"
#include "infer/inference.h"
#include "link/link.h"
#include "link/messages.h"
#include "link/session.h"
#include "segment_cut.h"
#include "segment_turns.h"

namespace ruffini {

struct DaemonOptions {
  bool is_lockstep = false;      // process every frame, drop none
  bool waits_for_host = false;   // the first frame waits for a subscription
  bool keeps_link_open = false;  // keep the link open after the recording's end
  uint64_t max_frames = 0;       // 0 = no limit
  bool is_open = true;           // commands that change something need no key
  NetworkLoader network{};       // empty: none
  // Called about once a second by the link thread. Returns a sentence if the hardware around the sensor has changed
  // since the start so that forces would be wrong; the daemon then ends with it. Empty: never called.
  std::function<std::string()> hardware_fault{};
  // Called like the above, with the thermometer's reading. Returns true if the lamps are not in the state that the
  // board demands; empty: never called.
  std::function<bool(std::optional<int32_t> milli_celsius)> has_light_fault{};
  // Rest image of the previous run, and where the link thread saves the current one. Empty: starts are not checked.
  std::vector<uint16_t> previous_rest{};
  std::function<void(std::span<const uint16_t> rest)> save_rest{};
  // Called first by each thread (capture, frame, link, inference); empty: nothing to do.
  std::function<void(const char* role)> on_thread_start{};
};

// Devices that the daemon uses. The calibrator owns the medium.
struct DaemonDevices {
  const Clock& clock;
  Random& random;
  std::unique_ptr<Camera> camera;
  std::unique_ptr<Link> link;
  std::unique_ptr<BoardIo> io;
};

class Daemon {
 public:
  Daemon(const BoardSettings& board, std::unique_ptr<FramePath> path, DaemonDevices devices, Calibrator& calibrator,
         Exchange& exchange, DeviceIdentity identity, DaemonOptions options);

  // Runs until the recording ends, `stop` is set, or max_frames were processed.
  void run(const std::atomic<bool>& stop);

  // Capture thread: moves one frame from the camera to the mailbox. Returns false if the camera has no more.
  bool capture_once();
  // Frame thread: processes the frame in the mailbox. Returns false if there is none.
  bool process_once();
  // Link thread: reads, answers, and writes as much as the line accepts; waits at most wait_ms. Returns false if the
  // line was lost.
  bool serve_once(int wait_ms);
  // Link thread, after a lost line: returns true if it is usable again.
  bool reopen_line() { return devices_.link->reopen(); }
  // After run(): why it ended, in one sentence; empty for a normal end.
  [[nodiscard]] std::string problem() const {
    return hardware_fault_.empty() ? devices_.camera->problem() : hardware_fault_;
  }

 private:
  void begin(const char* role);
  void capture_loop();
  void frame_loop();
  void link_loop();
  // Returns false if the frame must be skipped.
  [[nodiscard]] bool take_in_order(FramePool::Buffer& buffer);
  // A frame on its way through the segments of the path.
  struct Flight {
    std::optional<FrameLease> lease{};
    Frame frame{};
    uint64_t start_us = 0;  // when a frame thread took it
    // Of the first of two frame threads, without its wait to hand the frame over; where the cut has just risen, that
    // frame's wait for a segment counts.
    uint64_t first_us = 0;
  };
  std::optional<int> take_frame(uint32_t number);
  void start(uint32_t number, FrameLease lease);
  void finish(uint32_t number, uint64_t since_us);
  void finish_loop();
  void send_results(const FrameLease& lease);
  void offer_rest();
  void save_rest();
  void switch_reflex(const FrameState& state);
  void count_late(uint64_t capture_us);
  void govern_rate(uint64_t busy_us);
  [[nodiscard]] bool leaves_out();
  void count(uint32_t flags);
  void run_network(FrameLease lease);
  [[nodiscard]] bool has_requests() const;
  void wake_link();
  void swap_path();
  void read_board_health();
  void notify_manager(uint64_t now_us);
  [[nodiscard]] bool has_sent_all();
  void publish(ruffini_MessageType type, std::span<const uint8_t> frames);
  [[nodiscard]] bool is_stopping() const { return stop_->load(std::memory_order_relaxed) || is_done_; }

  BoardSettings board_;
  std::unique_ptr<FramePath> path_;
  DaemonDevices devices_;
  Exchange& exchange_;
  DeviceIdentity identity_;
  DaemonOptions options_;
  FrameOrder order_;         // capture thread
  uint32_t n_left_out_ = 0;  // capture thread: since the last frame that was used
  Reflex reflex_;            // frame thread
  RateGovernor governor_;    // frame thread that ends the frames
  Liveness<4> liveness_;
  uint64_t link_iterations_ = 0;
  bool is_ready_reported_ = false;  // READY was sent
  // A rest image on its way to the medium. The frame thread asks for room and fills it or gives it back; the link thread
  // allocates it, saves the image and frees the room, which is as large as two pictures.
  enum class RestRoom : uint8_t { kNone, kAsked, kEmpty, kFull, kUnneeded };
  std::atomic<RestRoom> rest_room_{RestRoom::kNone};
  std::vector<uint16_t> rest_to_save_;  // the frame thread's while kEmpty, else the link thread's
  uint32_t n_saved_rests_ = 0;
  Session session_;
  MessageEncoder encoder_;
  MessageEncoder::Sink sink_;
  std::array<uint8_t, 4'096> received_{};
  FramePool pool_;
  IndexMailbox mailbox_;
  std::array<Flight, 2> flights_{};  // by number
  SegmentTurns turns_;
  Turnstile handed_;  // by the first frame thread to the second
  SegmentCut cut_;
  uint32_t n_begun_ = 0;  // process_once()
  std::unique_ptr<Inference> network_;
  uint64_t n_network_results_ = 0;  // results of the network
  uint64_t exposed_us_ = 0;         // frame thread: TelemetryHead of what is published next
  bool has_published_ = false;      // frame thread: since the link thread was last woken
  uint64_t last_output_us_;         // last time that bytes were written
  uint64_t last_pending_us_;        // last time that bytes were pending
  uint64_t board_health_us_;        // time of the last reading of the board's health
  std::string hardware_fault_;      // from options_.hardware_fault
  const std::atomic<bool>* stop_ = nullptr;
  std::atomic<bool> is_done_{false};
  std::atomic<bool> is_frame_over_{false};
};

}  // namespace ruffini
