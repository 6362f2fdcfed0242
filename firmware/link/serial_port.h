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

  // Path that a host opens.
  [[nodiscard]] const std::string& host_path() const { return host_path_; }

  // A pty that no host has open counts as hung up.
  int read(std::span<uint8_t> out) override;
  int write(std::span<const uint8_t> bytes) override;
  void wait(bool is_writing, int timeout_ms) override;
  void wake() override;
  [[nodiscard]] bool has_unsent() const override;
  bool reopen() override;

 private:
  SerialPort() = default;
  Status open_pty();
  Status open_device();
  [[nodiscard]] UniqueFd open_slave() const;
  [[nodiscard]] bool is_stale() const;

  UniqueFd fd_;
  UniqueFd wake_;           // eventfd; never reopened, because another thread writes to it
  std::string slave_path_;  // empty for a device. Only hosts hold it open, so that the last close hangs up the line
  std::string link_;
  std::string host_path_;
  std::string symlink_;
  UniqueFd place_;  // directory entry of a device that is a pty, held without opening it; empty for other devices
  struct stat link_stat_{};  // state of link_ at that time
};

}  // namespace ruffini
