#include "capture/twin_camera.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include "base/unique_fd.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

struct StoppedClock final : Clock {
  [[nodiscard]] uint64_t now_us() const override { return 1'000'000; }
};

struct Greeting {
  const char* magic = "RFRC";
  uint32_t rate_mhz = 30'000;
};

// Serves one camera: a greeting, then frames with these numbers. It hangs up after the last one, without an end.
class Sender {
 public:
  Sender(const BoardSettings& board, const Greeting& greeting, std::vector<uint64_t> numbers)
      : path_(testing::TempDir() + "twin_camera_test" + std::to_string(::getpid())),
        listener_(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    ::unlink(path_.c_str());
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path_.copy(address.sun_path, sizeof address.sun_path - 1);
    EXPECT_EQ(::bind(listener_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    EXPECT_EQ(::listen(listener_.get(), 1), 0);
    thread_ = std::thread([this, board, greeting, numbers = std::move(numbers)] {
      const UniqueFd camera(::accept(listener_.get(), nullptr, nullptr));
      std::string hello = greeting.magic;
      for (const uint64_t value :
           {uint64_t{1}, static_cast<uint64_t>(board.camera.width_px), static_cast<uint64_t>(board.camera.height_px),
            uint64_t{greeting.rate_mhz}, static_cast<uint64_t>(board.name.size())}) {
        hello += little_endian(value, 4);
      }
      send(camera.get(), hello + board.name);
      char mode = 0;
      if (::recv(camera.get(), &mode, 1, 0) != 1) return;
      const size_t n_bytes = size_t{3} * static_cast<size_t>(board.camera.width_px * board.camera.height_px);
      for (const uint64_t number : numbers) {
        send(camera.get(),
             "RFTF" + little_endian(n_bytes, 4) + little_endian(number, 8) + std::string(n_bytes, '\x40'));
      }
    });
  }
  ~Sender() {
    thread_.join();
    ::unlink(path_.c_str());
  }
  [[nodiscard]] const std::string& path() const { return path_; }

 private:
  static std::string little_endian(uint64_t value, int n_bytes) {
    std::string out;
    for (int i = 0; i < n_bytes; ++i) out += static_cast<char>(value >> (8 * i) & 0xFF);
    return out;
  }
  static void send(int fd, const std::string& bytes) {
    for (size_t at = 0; at < bytes.size();) {
      const ssize_t n = ::send(fd, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
      if (n <= 0) return;
      at += static_cast<size_t>(n);
    }
  }

  std::string path_;
  UniqueFd listener_;
  std::thread thread_;
};

class TwinCameraTest : public testing::Test {
 protected:
  BoardSettings board_ = test::round_board();
  StoppedClock clock_;
  FramePool pool_{1, board_.camera.width_px, board_.camera.height_px};

  // The sender's thread may get no turn within the time that one call waits.
  [[nodiscard]] CaptureStatus first_of(Camera& camera) {
    const auto hangs = std::chrono::steady_clock::now() + std::chrono::minutes(2);
    CaptureStatus status{};
    do status = camera.capture(pool_[0]);
    while (status == CaptureStatus::kNothing && std::chrono::steady_clock::now() < hangs);
    return status;
  }
  [[nodiscard]] uint64_t time_of_frame_3(const Greeting& greeting, FrameSender sender) {
    const Sender server(board_, greeting, {3});
    const auto camera = open_twin(sender, server.path(), true, board_, clock_).value();
    EXPECT_EQ(first_of(*camera), CaptureStatus::kFrame);
    return pool_[0].capture_us;
  }
};

TEST_F(TwinCameraTest, InLockstepARecordingKeepsItsOwnTimeAndATwinTheBoards) {
  board_.camera.rate_mhz = 60'000;
  EXPECT_EQ(time_of_frame_3({.magic = "RFRC", .rate_mhz = 25'000}, FrameSender::kRecording), 120'000U);
  EXPECT_EQ(time_of_frame_3({.magic = "RFRS", .rate_mhz = 25'000}, FrameSender::kRecording), 120'000U);
  EXPECT_EQ(time_of_frame_3({.magic = "RFTC", .rate_mhz = 30'000}, FrameSender::kTwin), 50'000U);  // lit and dark
}

TEST_F(TwinCameraTest, ARecordingWithAnImpossibleRateIsRefused) {
  for (const uint32_t rate_mhz : {0U, 99U, 1'000'001U}) {
    const Sender server(board_, {.magic = "RFRC", .rate_mhz = rate_mhz}, {});
    const auto camera = open_twin(FrameSender::kRecording, server.path(), true, board_, clock_);
    ASSERT_FALSE(camera) << rate_mhz;
    EXPECT_EQ(camera.error().kind, ErrorKind::kBadInput);
  }
}

TEST_F(TwinCameraTest, MessagesNameTheSenderAndTheCommandThatStartsIt) {
  const Sender server(board_, {}, {});
  const auto camera = open_twin(FrameSender::kRecording, server.path(), true, board_, clock_).value();
  EXPECT_TRUE(camera->is_replay());
  EXPECT_EQ(first_of(*camera), CaptureStatus::kEnd);
  EXPECT_NE(camera->problem().find("the recording went away without an end: start `ruffini live` again"),
            std::string::npos)
      << camera->problem();
  const auto long_path = open_twin(FrameSender::kRecording, std::string(200, 'a'), true, board_, clock_);
  EXPECT_NE(long_path.error().message.find("--camera frames:aaa"), std::string::npos) << long_path.error().message;
}

}  // namespace
}  // namespace ruffini
