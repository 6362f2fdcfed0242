// The threads of ruffinid: capture -> frame -> link, and one beside them for a learned network where the board asks.
// firmware/README.md has the picture.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include "base/mailbox.h"
#include "capture/camera.h"
#include "hw/thermometer.h"
#include "infer/inference.h"
#include "link/messages.h"
#include "link/serial_port.h"
#include "link/session.h"

namespace ruffini {

struct DaemonOptions {
  bool is_lockstep = false;     // every frame, none dropped
  bool waits_for_host = false;  // the first frame waits for a subscription
  bool lingers = false;         // keep the link after the recording's end
  uint64_t max_frames = 0;      // 0 = no limit
  NetworkLoader network{};      // empty: none
};

class Daemon {
 public:
  Daemon(const BoardSettings& board, std::unique_ptr<FramePath> path, std::unique_ptr<Camera> camera, SerialPort port,
         Calibrator& calibrator, Exchange& exchange, DeviceIdentity identity, const DaemonOptions& options);

  // Runs until the recording ends, `stop` is set, or max_frames were processed.
  void run(const std::atomic<bool>& stop);
  // After run().
  [[nodiscard]] const Camera& camera() const { return *camera_; }

 private:
  void capture_loop();
  void frame_loop();
  void link_loop();
  void process(const FrameLease& lease);
  void count(uint32_t flags);
  void ask_network(FrameLease lease);
  void swap_path();
  void read_temperature();
  void publish(ruffini_MessageType type, std::span<const uint8_t> frames);
  [[nodiscard]] bool is_stopping() const { return stop_->load(std::memory_order_relaxed) || is_done_; }

  BoardSettings board_;
  std::unique_ptr<FramePath> path_;
  std::unique_ptr<Camera> camera_;
  SerialPort port_;
  Exchange& exchange_;
  DeviceIdentity identity_;
  DaemonOptions options_;
  Thermometer thermometer_;
  Session session_;
  MessageEncoder encoder_;
  MessageEncoder::Sink sink_;
  std::vector<uint8_t> outgoing_;
  FramePool pool_;
  IndexMailbox mailbox_;
  std::unique_ptr<Inference> network_;
  uint64_t n_learned_ = 0;  // results of the network
  const std::atomic<bool>* stop_ = nullptr;
  std::atomic<bool> is_done_{false};
  std::atomic<bool> is_frame_over_{false};
};

}  // namespace ruffini
