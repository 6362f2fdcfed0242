// The threads of ruffinid: capture -> frame -> link, and one beside them for a learned network where the board asks.
// firmware/README.md has the picture. Each thread repeats one step; tests/sim runs the same steps on a virtual clock.
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
#include "capture/camera.h"
#include "capture/frame_order.h"
#include "frame_reflex.h"
#include "hw/board_io.h"
#include "hw/liveness.h"
#include "infer/inference.h"
#include "link/link.h"
#include "link/messages.h"
#include "link/session.h"

namespace ruffini {

struct DaemonOptions {
  bool is_lockstep = false;     // every frame, none dropped
  bool waits_for_host = false;  // the first frame waits for a subscription
  bool lingers = false;         // keep the link after the recording's end
  uint64_t max_frames = 0;      // 0 = no limit
  bool is_open = true;          // no key is asked for before what changes something
  NetworkLoader network{};      // empty: none
  // Asked about once a second by the link thread: a sentence where what is round the sensor is not as at the start, and
  // forces would be wrong. The daemon then ends with it; empty: never.
  std::function<std::string()> lost{};
  // Asked as `lost`, with what the thermometer says: whether the lamps are not as the board asks; empty: never.
  std::function<bool(std::optional<int32_t> milli_celsius)> has_light_fault{};
  // Rest as the run before knew it, and where to put what this one knows, by the link thread; empty: starts are not watched.
  std::vector<uint16_t> known_rest{};
  std::function<void(std::span<const uint16_t> rest)> keep_rest{};
  // Called by each thread (capture, frame, link, inference) when it begins; empty: nothing is to be done.
  std::function<void(const char* role)> begun{};
};

// All that the daemon knows of the world; the medium is the calibrator's.
struct Surroundings {
  const Clock& clock;
  Random& random;
  std::unique_ptr<Camera> camera;
  std::unique_ptr<Link> link;
  std::unique_ptr<BoardIo> io;
};

class Daemon {
 public:
  Daemon(const BoardSettings& board, std::unique_ptr<FramePath> path, Surroundings around, Calibrator& calibrator,
         Exchange& exchange, DeviceIdentity identity, const DaemonOptions& options);

  // Runs until the recording ends, `stop` is set, or max_frames were processed.
  void run(const std::atomic<bool>& stop);

  // Capture thread: one frame from the camera to the mailbox. False: the camera has no more.
  bool capture_once();
  // Frame thread: the frame in the mailbox. False: there is none.
  bool process_once();
  // Link thread: reads, answers, writes what the line takes; waits for that at most so long. False: the line was lost.
  bool serve_once(int wait_ms);
  // Link thread: after a lost line. True when it is usable again.
  bool reopen_line() { return around_.link->reopen(); }
  // After run(): why it ended, in one sentence; empty where it came to its proper end.
  [[nodiscard]] std::string problem() const { return lost_.empty() ? around_.camera->problem() : lost_; }

 private:
  void begin(const char* role);
  void capture_loop();
  void frame_loop();
  void link_loop();
  // False: the frame is not used.
  [[nodiscard]] bool take_in_order(FramePool::Buffer& buffer);
  void process(const FrameLease& lease);
  void keep_rest();
  void switch_reflex(const FrameState& state);
  void count_late(uint64_t capture_us);
  void count(uint32_t flags);
  void ask_network(FrameLease lease);
  void swap_path();
  void read_computer();
  void tell_manager(uint64_t now_us);
  [[nodiscard]] bool has_said_all();
  void publish(ruffini_MessageType type, std::span<const uint8_t> frames);
  [[nodiscard]] bool is_stopping() const { return stop_->load(std::memory_order_relaxed) || is_done_; }

  BoardSettings board_;
  std::unique_ptr<FramePath> path_;
  Surroundings around_;
  Exchange& exchange_;
  DeviceIdentity identity_;
  DaemonOptions options_;
  FrameOrder order_;  // capture thread
  Reflex reflex_;     // frame thread
  Liveness<4> liveness_;
  uint64_t link_iterations_ = 0;
  bool is_manager_told_ = false;        // that all is ready
  std::vector<uint16_t> rest_to_keep_;  // the frame thread's while is_rest_to_keep_ is false, else the link thread's
  std::atomic<bool> is_rest_to_keep_{false};
  uint32_t n_kept_rests_ = 0;
  Session session_;
  MessageEncoder encoder_;
  MessageEncoder::Sink sink_;
  std::vector<uint8_t> outgoing_;
  std::array<uint8_t, 4'096> received_{};
  FramePool pool_;
  IndexMailbox mailbox_;
  std::unique_ptr<Inference> network_;
  uint64_t n_learned_ = 0;  // results of the network
  uint64_t moved_us_;       // the last time that something went out
  uint64_t owed_us_;        // the last time that something was still to go out
  uint64_t computer_us_;    // of the last reading of what the computer says of itself
  std::string lost_;        // what options_.lost said
  const std::atomic<bool>* stop_ = nullptr;
  std::atomic<bool> is_done_{false};
  std::atomic<bool> is_frame_over_{false};
};

}  // namespace ruffini
