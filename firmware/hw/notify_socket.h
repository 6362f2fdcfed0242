// What a service manager is told: READY=1, WATCHDOG=1, STOPPING=1 (sd_notify(3), a datagram to NOTIFY_SOCKET).
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "base/unique_fd.h"

namespace ruffini {

class NotifySocket {
 public:
  // Of the environment: NOTIFY_SOCKET, and WATCHDOG_USEC where WATCHDOG_PID is this process or absent.
  [[nodiscard]] static NotifySocket from_environment();
  // An empty address: nobody wants to know. An address that begins with @ is in the abstract name space.
  NotifySocket(const std::string& address, uint64_t watchdog_us);

  // Never blocks; a manager that does not listen is not waited for.
  void say(std::string_view what) const;
  // How often the manager wants to hear WATCHDOG=1; 0: never.
  [[nodiscard]] uint64_t watchdog_us() const { return watchdog_us_; }

 private:
  UniqueFd socket_;
  uint64_t watchdog_us_ = 0;
};

}  // namespace ruffini
