// A serial line: a tty device in raw mode, or the master side of a new pty. Never blocks.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "base/result.h"
#include "base/unique_fd.h"

namespace ruffini {

class SerialPort {
 public:
  // "pty" or "pty:SYMLINK" makes a pseudo-terminal, anything else is a device path.
  // Errors: kUnavailable with path and remedy.
  [[nodiscard]] static Result<SerialPort> open(const std::string& link);

  SerialPort(SerialPort&&) = default;
  SerialPort& operator=(SerialPort&&) = default;
  ~SerialPort();

  // What a host opens.
  [[nodiscard]] const std::string& host_path() const { return host_path_; }
  [[nodiscard]] int fd() const { return fd_.get(); }

  // Bytes moved; 0 = nothing now; -1 = the line hung up, or nobody has the pty open (reopen() may bring it back).
  int read(std::span<uint8_t> out);
  int write(std::span<const uint8_t> bytes);
  // Something that was written is still on its way to the host.
  [[nodiscard]] bool has_unsent() const;
  // After a hang-up: what the host before did not read is forgotten. True when the line is usable again.
  bool reopen();

 private:
  SerialPort() = default;
  Status open_pty();
  Status open_device();
  [[nodiscard]] UniqueFd open_slave() const;

  UniqueFd fd_;
  std::string slave_path_;  // empty for a device. Only hosts keep it open: the last one's close hangs up the line
  std::string link_;
  std::string host_path_;
  std::string symlink_;
};

}  // namespace ruffini
