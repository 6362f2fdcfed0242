// Lets numbered frames pass in order, whichever thread has them.
#pragma once

#include <atomic>
#include <cstdint>

#include "base/sleepers.h"

namespace ruffini {

// Frame 0 is first; the numbers wrap. What a thread did before pass() is seen after the next frame's wait_for(). No
// lock.
class Turnstile {
 public:
  // Returns when all frames before this one have passed. Precondition: fewer than 2^31 of them have not.
  void wait_for(uint32_t number) {
    for (uint32_t next = next_.load(); static_cast<int32_t>(next - number) < 0; next = next_.load()) {
      sleepers_.sleep_while(next_, next);
    }
  }
  // Call once for each frame, in order.
  void pass() {
    next_.fetch_add(1);
    sleepers_.wake(next_);
  }

 private:
  std::atomic<uint32_t> next_{0};
  Sleepers sleepers_;
};

}  // namespace ruffini
