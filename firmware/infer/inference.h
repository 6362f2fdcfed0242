// Thread of a learned network. It never delays the frame path: frames are lent, not copied; the newest one wins; and
// the thread runs only when the CPU is idle. It loads and allocates in its own thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "base/latest.h"
#include "base/mailbox.h"
#include "capture/camera.h"
#include "infer/learned_result.h"
#include "infer/network.h"

namespace ruffini {

class Inference {
 public:
  static constexpr int kBuffers = 2;  // buffers of the pool that it may hold: one being processed, one waiting

  // With `is_lockstep` it runs at full priority, because the frame thread waits for it. Its thread calls
  // `on_thread_start` first.
  Inference(NetworkLoader loader, FramePool& pool, int n_buffers, NetworkHealth& health, bool is_lockstep,
            std::function<void()> on_thread_start = {});
  Inference(const Inference&) = delete;
  Inference& operator=(const Inference&) = delete;
  ~Inference();

  // Frame thread. Takes ownership of the frame. A waiting frame that was not processed returns to the pool.
  void post(FrameLease lease, uint32_t flags, uint32_t calibration_id);
  // Frame thread. Waits until all posted frames are processed.
  void wait_idle() const;
  // Frame thread: the newest result since the last call, or nullptr.
  [[nodiscard]] const LearnedResult* take() { return results_.take(); }
  // Valid after the first result.
  [[nodiscard]] std::span<const std::string> names() const { return card_.names; }

 private:
  void loop();
  [[nodiscard]] Status load();
  void infer(const FrameLease& lease, const LearnedStamp& stamp);
  void settle();

  NetworkLoader loader_;
  FramePool& pool_;
  NetworkHealth& health_;
  bool is_lockstep_;
  std::function<void()> on_thread_start_;
  NetworkCard card_;
  std::unique_ptr<Network> network_;
  std::vector<float> raw_;
  uint64_t result_us_ = 0;           // time of the last result
  std::vector<LearnedStamp> stamp_;  // of each buffer of the pool
  IndexMailbox mailbox_;
  std::atomic<int> n_pending_{0};  // posted frames that are neither processed nor returned
  Latest<LearnedResult> results_;
  std::thread thread_;
};

}  // namespace ruffini
