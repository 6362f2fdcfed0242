#include "link/serial_port.h"

#include <fcntl.h>
#include <pty.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <termios.h>

#include <cerrno>
#include <cstring>

namespace ruffini {
namespace {

Error unavailable(const std::string& path, const std::string& what) {
  return {ErrorKind::kUnavailable,
          path + ": cannot " + what + ": " + std::strerror(errno) + ": is it there, free, and are you in its group?"};
}

bool set_raw(int fd) {
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) return false;
  ::cfmakeraw(&settings);
  settings.c_cflag |= CLOCAL | CREAD;
  return ::tcsetattr(fd, TCSANOW, &settings) == 0;
}

int moved(ssize_t n) {
  if (n > 0) return static_cast<int>(n);
  if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) return 0;
  return n == 0 ? 0 : -1;
}

}  // namespace

Result<SerialPort> SerialPort::open(const std::string& link) {
  SerialPort port;
  port.link_ = link;
  if (link.rfind("pty:", 0) == 0) port.symlink_ = link.substr(4);
  Status opened = link == "pty" || !port.symlink_.empty() ? port.open_pty() : port.open_device();
  if (!opened) return opened.error();
  return port;
}

SerialPort::~SerialPort() {
  if (fd_ && !symlink_.empty()) ::unlink(symlink_.c_str());
}

Status SerialPort::open_pty() {
  int master = -1;
  int slave = -1;
  char name[128];
  if (::openpty(&master, &slave, name, nullptr, nullptr) != 0) return unavailable("pty", "make a pseudo-terminal");
  fd_.reset(master);
  slave_.reset(slave);
  ::fcntl(master, F_SETFL, O_NONBLOCK);
  ::fcntl(master, F_SETFD, FD_CLOEXEC);
  if (!set_raw(slave)) return unavailable(name, "set raw mode");
  host_path_ = name;
  if (!symlink_.empty()) {
    ::unlink(symlink_.c_str());
    if (::symlink(name, symlink_.c_str()) != 0) return unavailable(symlink_, "make the link");
    host_path_ = symlink_;
  }
  return Unit{};
}

Status SerialPort::open_device() {
  fd_.reset(::open(link_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!fd_) return unavailable(link_, "open");
  if (::flock(fd_.get(), LOCK_EX | LOCK_NB) != 0 || ::ioctl(fd_.get(), TIOCEXCL) != 0) {
    return unavailable(link_, "have for itself");
  }
  if (!set_raw(fd_.get())) return unavailable(link_, "set raw mode (not a serial line?)");
  host_path_ = link_;
  return Unit{};
}

int SerialPort::read(std::span<uint8_t> out) { return moved(::read(fd_.get(), out.data(), out.size())); }

int SerialPort::write(std::span<const uint8_t> bytes) { return moved(::write(fd_.get(), bytes.data(), bytes.size())); }

int SerialPort::unsent() const {
  int n = 0;
  const int failed = slave_ ? ::ioctl(slave_.get(), FIONREAD, &n) : ::ioctl(fd_.get(), TIOCOUTQ, &n);
  return failed == 0 ? n : 0;
}

bool SerialPort::reopen() {
  if (slave_) return true;  // a pty's master outlives its hosts
  fd_.reset();
  return open_device().has_value();
}

}  // namespace ruffini
