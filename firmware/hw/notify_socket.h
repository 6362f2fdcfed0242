// Sends READY=1, WATCHDOG=1 and STOPPING=1 to the service manager (sd_notify(3), a datagram to NOTIFY_SOCKET).
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "base/unique_fd.h"

namespace ruffini {

class NotifySocket {
 public:
  // From the environment: NOTIFY_SOCKET, and WATCHDOG_USEC if WATCHDOG_PID is this process or absent.
  [[nodiscard]] static NotifySocket from_environment();
  // An empty address: there is no manager. An address that begins with @ is in the abstract name space.
  NotifySocket(const std::string& address, uint64_t watchdog_us);

  // Never blocks, even if the manager does not read.
  void send(std::string_view what) const;
  // Interval at which the manager expects WATCHDOG=1; 0: never.
  [[nodiscard]] uint64_t watchdog_us() const { return watchdog_us_; }

 private:
  UniqueFd socket_;
  uint64_t watchdog_us_ = 0;
};

}  // namespace ruffini
