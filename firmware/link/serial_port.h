// A serial line: a tty device in raw mode, or the master side of a new pty. Never blocks.
#pragma once

#include <sys/stat.h>

#include <cstdint>
#include <span>
#include <string>

#include "base/result.h"
#include "base/unique_fd.h"
#include "link/link.h"

namespace ruffini {

class SerialPort final : public Link {
 public:
  // "pty" or "pty:SYMLINK" makes a pseudo-terminal, anything else is a device path.
  // Errors: kUnavailable with path and remedy.
  [[nodiscard]] static Result<SerialPort> open(const std::string& link);

  SerialPort(SerialPort&&) = default;
  SerialPort& operator=(SerialPort&&) = default;
  ~SerialPort() override;

  // What a host opens.
  [[nodiscard]] const std::string& host_path() const { return host_path_; }

  // A pty that nobody has open has hung up, too.
  int read(std::span<uint8_t> out) override;
  int write(std::span<const uint8_t> bytes) override;
  void wait(bool is_writing, int timeout_ms) override;
  [[nodiscard]] bool has_unsent() const override;
  bool reopen() override;

 private:
  SerialPort() = default;
  Status open_pty();
  Status open_device();
  [[nodiscard]] UniqueFd open_slave() const;
  [[nodiscard]] bool is_stale() const;

  UniqueFd fd_;
  std::string slave_path_;  // empty for a device. Only hosts keep it open: the last one's close hangs up the line
  std::string link_;
  std::string host_path_;
  std::string symlink_;
  UniqueFd place_;           // where a device that is a pty was, without opening it; empty for other devices
  struct stat link_stat_{};  // of link_ then
};

}  // namespace ruffini
