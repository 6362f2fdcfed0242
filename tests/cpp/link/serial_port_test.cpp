#include "link/serial_port.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

namespace {

// A close() that waits, as that of a tty whose host takes nothing: of this descriptor, until it is let go.
std::atomic<int> g_slow_fd{-1};
std::atomic<bool> g_is_closing{false};
std::atomic<bool> g_is_let_go{false};
std::atomic<bool> g_has_given_up{false};

}  // namespace

extern "C" int close(int fd) {
  if (fd >= 0 && fd == g_slow_fd) {
    g_is_closing = true;
    for (int i = 0; i < 120'000 && !g_is_let_go; ++i) ::usleep(1'000);
    g_has_given_up = !g_is_let_go;
    g_is_closing = false;
  }
  return static_cast<int>(::syscall(SYS_close, fd));
}

namespace ruffini {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

UniqueFd open_host(const std::string& path) {
  return UniqueFd(::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
}

// What is there now; empty when nothing is.
Bytes read_now(int fd) {
  Bytes bytes(4'096);
  const ssize_t n = ::read(fd, bytes.data(), bytes.size());
  bytes.resize(n > 0 ? static_cast<size_t>(n) : 0);
  return bytes;
}

// The kernel hands bytes from one end to the other in its own time. Two minutes guard against a hang.
template <typename Condition>
bool becomes_true(Condition condition) {
  for (int i = 0; i < 120'000; ++i) {
    if (condition()) return true;
    ::usleep(1'000);
  }
  return false;
}

class SerialPortTest : public testing::Test {
 protected:
  SerialPortTest() : folder_(testing::TempDir() + "serial_port_test" + std::to_string(::getpid())) {
    fs::create_directories(folder_);
  }
  ~SerialPortTest() override { fs::remove_all(folder_); }
  std::string folder_;
};

// A line as a device sees it: the test holds the other end, `path` leads to it.
class Wire {
 public:
  explicit Wire(const std::string& path) {
    int other = -1;
    int device = -1;
    char name[128];
    EXPECT_EQ(::openpty(&other, &device, name, nullptr, nullptr), 0);
    other_.reset(other);
    ::close(device);
    fs::remove(path);
    fs::create_symlink(name, path);
  }
  [[nodiscard]] int fd() const { return other_.get(); }

 private:
  UniqueFd other_;
};

TEST_F(SerialPortTest, EveryByteGoesThroughBothWays) {
  SerialPort port = SerialPort::open("pty").value();
  Bytes all(256);
  std::iota(all.begin(), all.end(), uint8_t{0});
  for (int i = 0; i < 2; ++i) {  // the second host finds the line as the first one did
    const UniqueFd host = open_host(port.host_path());
    ASSERT_EQ(port.write(all), 256);
    Bytes got;
    EXPECT_TRUE(becomes_true([&] {
      const Bytes more = read_now(host.get());
      got.insert(got.end(), more.begin(), more.end());
      return got.size() >= all.size();
    }));
    EXPECT_EQ(got, all);
    ASSERT_EQ(::write(host.get(), all.data(), all.size()), 256);
    got.assign(256, 0xAA);
    size_t n = 0;
    EXPECT_TRUE(becomes_true([&] {
      n += static_cast<size_t>(port.read(std::span(got).subspan(n)));
      return n >= all.size();
    }));
    EXPECT_EQ(got, all);
  }
}

TEST_F(SerialPortTest, AHostThatGoesHangsUpAndTheNextOneGetsNothingOld) {
  SerialPort port = SerialPort::open("pty").value();
  Bytes got(16);
  EXPECT_EQ(port.read(got), -1) << "nobody is there yet";
  UniqueFd host = open_host(port.host_path());
  EXPECT_EQ(port.read(got), 0);
  ASSERT_GT(port.write(Bytes(1'000, 7)), 0);
  ASSERT_EQ(::write(host.get(), "x", 1), 1);
  host.reset();
  EXPECT_EQ(port.read(got), 1) << "what it sent comes before its end";
  EXPECT_EQ(port.read(got), -1);
  EXPECT_TRUE(port.reopen());
  EXPECT_FALSE(port.has_unsent());
  host = open_host(port.host_path());
  EXPECT_EQ(port.read(got), 0);
  EXPECT_TRUE(read_now(host.get()).empty());
}

TEST_F(SerialPortTest, HasUnsentUntilTheHostTookTheLastByte) {
  SerialPort port = SerialPort::open("pty").value();
  const UniqueFd host = open_host(port.host_path());
  EXPECT_FALSE(port.has_unsent());
  size_t n_left = 0;
  for (int n = 1; n > 0;) {  // until the line is full: more than the host's end holds at a time
    n = port.write(Bytes(1'000, 7));
    ASSERT_GE(n, 0);
    n_left += static_cast<size_t>(n);
  }
  ASSERT_GT(n_left, 4'096U);
  while (n_left > 0) {
    ASSERT_TRUE(port.has_unsent()) << n_left;
    n_left -= read_now(host.get()).size();
  }
  EXPECT_FALSE(port.has_unsent());
}

TEST_F(SerialPortTest, ADeviceThatIsUnpluggedReadsAsGoneAndComesBack) {
  const std::string path = folder_ + "/tty";
  auto wire = std::make_unique<Wire>(path);
  SerialPort port = SerialPort::open(path).value();
  Bytes got(16);
  EXPECT_EQ(port.read(got), 0);
  wire.reset();
  EXPECT_EQ(port.read(got), -1);
  EXPECT_FALSE(port.reopen());
  EXPECT_EQ(port.read(got), -1);
  wire = std::make_unique<Wire>(path);
  ASSERT_TRUE(port.reopen());
  ASSERT_EQ(::write(wire->fd(), "hi", 2), 2);
  EXPECT_TRUE(becomes_true([&] { return port.read(got) == 2; }));
}

// Waits until the clock that stamps new ptys is past the link's own stamp, which may be finer and so ahead of it.
void wait_until_older(const std::string& link) {
  struct stat made{};
  ASSERT_EQ(::lstat(link.c_str(), &made), 0);
  timespec now{};
  do {
    ::usleep(1'000);
    ::clock_gettime(CLOCK_REALTIME_COARSE, &now);
  } while (std::pair{now.tv_sec, now.tv_nsec} <= std::pair{made.st_mtim.tv_sec, made.st_mtim.tv_nsec});
}

// The number of a pty is free again as soon as it is closed, and the next program that asks gets it.
TEST_F(SerialPortTest, AStrangersPtyUnderTheOldNumberIsNotTaken) {
  const std::string path = folder_ + "/tty";
  for (const bool by_link : {true, false}) {
    auto wire = std::make_unique<Wire>(path);
    const std::string number = fs::read_symlink(path).string();
    SerialPort port = SerialPort::open(by_link ? path : number).value();
    wire.reset();
    Bytes got(16);
    EXPECT_EQ(port.read(got), -1);
    EXPECT_FALSE(port.reopen());  // closes its end: only now is the number free
    std::vector<std::unique_ptr<Wire>> strangers;
    const std::string elsewhere = folder_ + "/stranger";
    do {
      wait_until_older(path);
      strangers.push_back(std::make_unique<Wire>(elsewhere));
    } while (fs::read_symlink(elsewhere) != number && strangers.size() < 100);
    EXPECT_FALSE(port.reopen());
    // Another process may have been faster: then the number is a stranger's, too.
    if (fs::read_symlink(elsewhere) == number) {
      EXPECT_TRUE(SerialPort::open(elsewhere)) << "the stranger's own line is free";
    }
    if (!by_link) continue;
    wire = std::make_unique<Wire>(path);
    EXPECT_TRUE(port.reopen()) << "the link was made again, so it is meant";
  }
}

TEST_F(SerialPortTest, ACloseThatWaitsHoldsNobodyUp) {
  const std::string path = folder_ + "/tty";
  auto wire = std::make_unique<Wire>(path);
  const int next = ::dup(0);  // the descriptor that the port will get
  ::close(next);
  SerialPort port = SerialPort::open(path).value();
  wire = std::make_unique<Wire>(path);
  g_slow_fd = next;
  EXPECT_TRUE(port.reopen());
  EXPECT_TRUE(becomes_true([] { return g_is_closing.load(); })) << "the old line is still being closed";
  ASSERT_EQ(::write(wire->fd(), "hi", 2), 2);
  Bytes got(16);
  EXPECT_TRUE(becomes_true([&] { return port.read(got) == 2; }));
  g_is_let_go = true;
  EXPECT_TRUE(becomes_true([] { return !g_is_closing.load(); }));
  g_slow_fd = -1;
  EXPECT_FALSE(g_has_given_up);
}

// A getty left the line in cooked mode: echo, flow control, newline translation.
TEST_F(SerialPortTest, AHostileTerminalIsSetRawAtEveryOpening) {
  const std::string path = folder_ + "/tty";
  std::unique_ptr<SerialPort> port;
  for (int i = 0; i < 2; ++i) {
    const Wire wire(path);
    const UniqueFd device = open_host(path);
    termios mode{};
    ASSERT_EQ(::tcgetattr(device.get(), &mode), 0);
    mode.c_iflag |= IXON | IXOFF | IXANY | ICRNL | INLCR | IGNCR | ISTRIP | BRKINT;
    mode.c_oflag |= OPOST | ONLCR;
    mode.c_lflag |= ECHO | ECHONL | ICANON | ISIG | IEXTEN;
    ASSERT_EQ(::tcsetattr(device.get(), TCSANOW, &mode), 0);
    if (port == nullptr) port = std::make_unique<SerialPort>(SerialPort::open(path).value());
    ASSERT_TRUE(i == 0 || port->reopen());
    ASSERT_EQ(::tcgetattr(device.get(), &mode), 0);
    EXPECT_EQ(mode.c_iflag & (IXON | IXOFF | IXANY | ICRNL | INLCR | IGNCR | ISTRIP | BRKINT), 0U);
    EXPECT_EQ(mode.c_oflag & OPOST, 0U);
    EXPECT_EQ(mode.c_lflag & (ECHO | ECHONL | ICANON | ISIG | IEXTEN), 0U);
    Bytes all(256);
    std::iota(all.begin(), all.end(), uint8_t{0});
    ASSERT_EQ(::write(wire.fd(), all.data(), all.size()), 256);
    Bytes got(512);
    size_t n = 0;
    EXPECT_TRUE(becomes_true([&] {
      n += static_cast<size_t>(std::max(port->read(std::span(got).subspan(n)), 0));
      return n >= all.size();
    }));
    got.resize(n);
    EXPECT_EQ(got, all);
  }
}

TEST_F(SerialPortTest, ALargeMessageGoesOutInSmallWrites) {
  SerialPort port = SerialPort::open("pty").value();
  const UniqueFd host = open_host(port.host_path());
  EXPECT_LE(port.write(Bytes(10'000, 7)), 4'096);
}

TEST_F(SerialPortTest, ALineInUseIsRefused) {
  const std::string path = folder_ + "/tty";
  const Wire wire(path);
  const SerialPort first = SerialPort::open(path).value();
  const auto second = SerialPort::open(path);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(second.error().message.find(path), std::string::npos);
}

TEST_F(SerialPortTest, TheLinkToAPtyReplacesAnOldLinkButNoFile) {
  const std::string path = folder_ + "/port";
  fs::create_symlink("/dev/pts/of-a-daemon-that-died", path);
  {
    const SerialPort port = SerialPort::open("pty:" + path).value();
    EXPECT_EQ(port.host_path(), path);
    EXPECT_TRUE(open_host(path));
  }
  EXPECT_FALSE(fs::is_symlink(path)) << "gone with its pty";
  std::ofstream(path) << "precious";
  const auto refused = SerialPort::open("pty:" + path);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kBadInput);
  EXPECT_EQ(fs::file_size(path), 8U);
}

}  // namespace
}  // namespace ruffini
