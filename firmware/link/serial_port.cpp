#include "link/serial_port.h"

#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <termios.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <string_view>
#include <thread>
#include <utility>

namespace ruffini {
namespace {

Error unavailable(const std::string& path, const std::string& what) {
  return {ErrorKind::kUnavailable,
          path + ": cannot " + what + ": " + std::strerror(errno) + ": is it there, free, and are you in its group?"};
}

// A slow host lost parts of larger writes on a USB line.
constexpr size_t kMaxWriteBytes = 4'096;

// Input flags that alter, delay or answer bytes.
constexpr tcflag_t kInputFlags = IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON | IXOFF | IXANY;
constexpr tcflag_t kLocalFlags = ECHO | ECHONL | ICANON | ISIG | IEXTEN;

// 8 data bits, no parity, one stop bit, no flow control. The speed matters on a UART only and equals the host tool's.
bool set_raw(int fd) {
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) return false;
  ::cfmakeraw(&settings);
  settings.c_iflag &= ~kInputFlags;  // cfmakeraw() leaves IXOFF and IXANY
  settings.c_cflag |= CLOCAL | CREAD;
  settings.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | CRTSCTS);
  ::cfsetspeed(&settings, B115200);
  if (::tcsetattr(fd, TCSANOW, &settings) != 0) return false;
  // tcsetattr() reports success if it made any of the changes.
  termios now{};
  if (::tcgetattr(fd, &now) != 0) return false;
  errno = EINVAL;
  return (now.c_iflag & kInputFlags) == 0 && (now.c_oflag & OPOST) == 0 && (now.c_lflag & kLocalFlags) == 0 &&
         (now.c_cflag & (CSIZE | PARENB)) == CS8;
}

// close() of a tty may block for many seconds until written data has been sent, which will not happen.
void close_elsewhere(UniqueFd fd) {
  if (!fd) return;
  ::tcflush(fd.get(), TCIOFLUSH);
  ::ioctl(fd.get(), TIOCNXCL);  // allows the line to be opened again before close() returns
  ::flock(fd.get(), LOCK_UN);
  std::thread([fd = std::move(fd)]() mutable { fd.reset(); }).detach();
}

bool is_only_late() { return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR; }

std::pair<time_t, long> time_of(const timespec& t) { return {t.tv_sec, t.tv_nsec}; }

bool is_link_to(const std::string& path, const std::string& target) {
  std::error_code failed;
  return std::filesystem::read_symlink(path, failed) == target;
}

}  // namespace

Result<SerialPort> SerialPort::open(const std::string& link) {
  SerialPort port;
  port.link_ = link;
  if (link.rfind("pty:", 0) == 0) port.symlink_ = link.substr(4);
  Status opened = link == "pty" || !port.symlink_.empty() ? port.open_pty() : port.open_device();
  if (!opened) return opened.error();
  port.wake_.reset(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC));
  if (!port.wake_) return unavailable(link, "make an eventfd for");
  return port;
}

SerialPort::~SerialPort() {
  if (fd_ && !symlink_.empty() && is_link_to(symlink_, slave_path_)) ::unlink(symlink_.c_str());
}

Status SerialPort::open_pty() {
  int master = -1;
  int slave = -1;
  char name[128];
  if (::openpty(&master, &slave, name, nullptr, nullptr) != 0) return unavailable("pty", "make a pseudo-terminal");
  fd_.reset(master);
  const UniqueFd raw(slave);
  slave_path_ = name;
  ::fcntl(master, F_SETFL, O_NONBLOCK);
  ::fcntl(master, F_SETFD, FD_CLOEXEC);
  if (!set_raw(slave)) return unavailable(name, "set raw mode");
  host_path_ = name;
  if (!symlink_.empty()) {
    struct stat there{};
    if (::lstat(symlink_.c_str(), &there) == 0 && !S_ISLNK(there.st_mode)) {
      return Error{ErrorKind::kBadInput, symlink_ + ": is there and is no link: choose another name for the pty"};
    }
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
  place_.reset();
  char name[128];
  if (::ttyname_r(fd_.get(), name, sizeof(name)) == 0 && std::string_view(name).starts_with("/dev/pts/") &&
      ::lstat(link_.c_str(), &link_stat_) == 0) {
    place_.reset(::open(link_.c_str(), O_PATH | O_CLOEXEC));
  }
  return Unit{};
}

// The kernel reuses the number of a pty as soon as it is closed: a link that has not been recreated since leads
// nowhere, or to another program's line. A link recreated within one clock tick may look unchanged, but is not older
// than its target.
bool SerialPort::is_stale() const {
  struct stat place{};
  if (!place_ || ::fstat(place_.get(), &place) != 0 || place.st_nlink > 0) return false;
  if (!S_ISLNK(link_stat_.st_mode)) return true;
  struct stat link{};
  struct stat target{};
  return ::lstat(link_.c_str(), &link) == 0 && ::stat(link_.c_str(), &target) == 0 &&
         link.st_ino == link_stat_.st_ino && link.st_dev == link_stat_.st_dev &&
         time_of(link.st_ctim) == time_of(link_stat_.st_ctim) && time_of(target.st_ctim) > time_of(link.st_mtim);
}

int SerialPort::read(std::span<uint8_t> out) {
  const ssize_t n = ::read(fd_.get(), out.data(), out.size());
  if (n > 0) return static_cast<int>(n);
  return n < 0 && is_only_late() ? 0 : -1;  // a line that hung up reads as end of file
}

int SerialPort::write(std::span<const uint8_t> bytes) {
  const ssize_t n = ::write(fd_.get(), bytes.data(), std::min(bytes.size(), kMaxWriteBytes));
  return n >= 0 ? static_cast<int>(n) : is_only_late() ? 0 : -1;
}

void SerialPort::wait(bool is_writing, int timeout_ms) {
  pollfd waits[] = {{fd_.get(), static_cast<short>(POLLIN | (is_writing ? POLLOUT : 0)), 0}, {wake_.get(), POLLIN, 0}};
  ::poll(waits, std::size(waits), timeout_ms);
  uint64_t n_wakes = 0;
  if ((waits[1].revents & POLLIN) != 0) (void)!::read(wake_.get(), &n_wakes, sizeof n_wakes);
}

// Fails only if 2^64 - 2 wakes are pending, so that wait() ends anyhow.
void SerialPort::wake() {
  constexpr uint64_t kOne = 1;
  (void)!::write(wake_.get(), &kOne, sizeof kOne);
}

UniqueFd SerialPort::open_slave() const {
  return UniqueFd(::open(slave_path_.c_str(), O_RDONLY | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
}

bool SerialPort::has_unsent() const {
  if (slave_path_.empty()) {
    int n = 0;
    return ::ioctl(fd_.get(), TIOCOUTQ, &n) == 0 && n > 0;
  }
  // poll() flushes data that the kernel still holds between the two ends; FIONREAD would not see it.
  const UniqueFd slave = open_slave();
  pollfd wait{slave.get(), POLLIN, 0};
  return slave && ::poll(&wait, 1, 0) > 0 && (wait.revents & POLLIN) != 0;
}

bool SerialPort::reopen() {
  if (!slave_path_.empty()) {  // the master of a pty outlives its hosts
    const UniqueFd slave = open_slave();
    return slave && ::tcflush(slave.get(), TCIFLUSH) == 0;
  }
  close_elsewhere(std::move(fd_));
  return !is_stale() && open_device().has_value();
}

}  // namespace ruffini
