// What the computer says of its power and heat, what its service manager is told, and its GPIO lines.
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "base/unique_fd.h"
#include "hw/notify_socket.h"
#include "hw/output_line.h"
#include "hw/throttling.h"

namespace ruffini {
namespace {

class Computer : public testing::Test {
 protected:
  Computer() { std::filesystem::create_directories(folder_); }
  ~Computer() override { std::filesystem::remove_all(folder_); }
  std::string write(const std::string& text) {
    const std::string path = folder_ + "/get_throttled";
    std::ofstream(path) << text;
    return path;
  }
  std::string folder_ = testing::TempDir() + "computer" + std::to_string(::getpid());
};

TEST_F(Computer, ThrottlingIsReadAsTheFirmwareWritesIt) {
  EXPECT_EQ(Throttling(write("0\n")).bits(), 0U);
  EXPECT_EQ(Throttling(write("50005\n")).bits(), 0x50005U);
  EXPECT_EQ(Throttling(write("0x50005")).bits(), 0x50005U);
  for (const char* other : {"", "\n", "throttled=0x0", "5 5", "-1", "123456789", "0x"}) {
    EXPECT_EQ(Throttling(write(other)).bits(), std::nullopt) << other;
  }
  EXPECT_EQ(Throttling(folder_ + "/none").bits(), std::nullopt);
  EXPECT_EQ(Throttling("").bits(), std::nullopt);
}

// The manager's end.
class Manager {
 public:
  explicit Manager(const std::string& address) : socket_(::socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0)) {
    sockaddr_un at{};
    at.sun_family = AF_UNIX;
    std::memcpy(at.sun_path, address.data(), address.size());
    if (address[0] == '@') at.sun_path[0] = '\0';
    const auto n_bytes = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + address.size());
    EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<const sockaddr*>(&at), n_bytes), 0);
  }
  std::string heard() {
    char text[64];
    const ssize_t n = ::recv(socket_.get(), text, sizeof text, 0);
    return n < 0 ? "" : std::string(text, static_cast<size_t>(n));
  }

 private:
  UniqueFd socket_;
};

TEST_F(Computer, TheServiceManagerHearsWhatIsSaid) {
  for (const std::string& address : {folder_ + "/notify", "@ruffini-test-" + std::to_string(::getpid())}) {
    Manager manager(address);
    const NotifySocket socket(address, 2'000'000);
    EXPECT_EQ(socket.watchdog_us(), 2'000'000U);
    socket.send("READY=1");
    EXPECT_EQ(manager.heard(), "READY=1");
    for (int i = 0; i < 10'000; ++i) socket.send("WATCHDOG=1");  // nobody takes them: no call blocks
    EXPECT_EQ(manager.heard(), "WATCHDOG=1");
  }
}

TEST_F(Computer, WithoutAManagerThereIsNoWatchdog) {
  const NotifySocket none("", 2'000'000);
  EXPECT_EQ(none.watchdog_us(), 0U);
  none.send("READY=1");
  EXPECT_EQ(NotifySocket(folder_ + "/nobody", 2'000'000).watchdog_us(), 0U);
  EXPECT_EQ(NotifySocket(std::string(200, 'a'), 2'000'000).watchdog_us(), 0U);
}

TEST_F(Computer, TheWatchdogOfAnotherProcessIsNotOurs) {
  const std::string address = folder_ + "/notify";
  Manager manager(address);
  ::setenv("NOTIFY_SOCKET", address.c_str(), 1);
  ::setenv("WATCHDOG_USEC", "2000000", 1);
  EXPECT_EQ(NotifySocket::from_environment().watchdog_us(), 2'000'000U);
  ::setenv("WATCHDOG_PID", std::to_string(::getpid()).c_str(), 1);
  EXPECT_EQ(NotifySocket::from_environment().watchdog_us(), 2'000'000U);
  ::setenv("WATCHDOG_PID", "1", 1);
  EXPECT_EQ(NotifySocket::from_environment().watchdog_us(), 0U);
  for (const char* name : {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"}) ::unsetenv(name);
}

TEST_F(Computer, AMissingChipIsNamedWithARemedy) {
  for (const std::string& chip : {folder_ + "/gpiochip0", write("no chip"), std::string("gpiochip99")}) {
    const auto line = open_output_line(chip, "GRIP");
    ASSERT_FALSE(line);
    EXPECT_EQ(line.error().kind, ErrorKind::kUnavailable);
    EXPECT_NE(line.error().message.find(chip), std::string::npos) << line.error().message;
    EXPECT_NE(line.error().message.find("the chip in board.toml"), std::string::npos) << line.error().message;
  }
}

}  // namespace
}  // namespace ruffini
