// The thread of a learned network. It never delays the frame path: frames are lent to it, not copied, the newest wins,
// and it runs when nothing else wants the core. What it loads and allocates, it does in its own thread.
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
  static constexpr int kBuffers = 2;  // of the pool, that it may hold: one looked at, one waiting

  // With `is_lockstep` it runs at full priority: the frame thread waits for it. Its thread calls `begun` at first.
  Inference(NetworkLoader loader, FramePool& pool, int n_buffers, NetworkHealth& health, bool is_lockstep,
            std::function<void()> begun = {});
  Inference(const Inference&) = delete;
  Inference& operator=(const Inference&) = delete;
  ~Inference();

  // Frame thread. Takes the frame over; one that was not looked at yet goes back to the pool.
  void post(FrameLease lease, uint32_t flags, uint32_t calibration_id);
  // Frame thread: waits until nothing that was posted is left to be looked at.
  void wait_idle() const;
  // Frame thread: the newest result since the last call, or nullptr.
  [[nodiscard]] const LearnedResult* take() { return results_.take(); }
  // Once there was a result.
  [[nodiscard]] std::span<const std::string> names() const { return card_.names; }

 private:
  void loop();
  [[nodiscard]] Status load();
  void look(const FrameLease& lease, const LearnedStamp& stamp);
  void settle();

  NetworkLoader loader_;
  FramePool& pool_;
  NetworkHealth& health_;
  bool is_lockstep_;
  std::function<void()> begun_;
  NetworkCard card_;
  std::unique_ptr<Network> network_;
  std::vector<float> raw_;
  uint64_t result_us_ = 0;           // when the last result was there
  std::vector<LearnedStamp> stamp_;  // of each buffer of the pool
  IndexMailbox mailbox_;
  std::atomic<int> n_open_{0};  // posted, neither looked at nor given back
  Latest<LearnedResult> results_;
  std::thread thread_;
};

}  // namespace ruffini
