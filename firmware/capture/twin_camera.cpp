#include "capture/twin_camera.h"

#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>

#include <array>
#include <bit>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <span>
#include <thread>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

using SteadyClock = std::chrono::steady_clock;
using namespace std::chrono_literals;

constexpr auto kConnectPatience = 2s;
constexpr auto kFramePatience = 2s;          // from the first byte of a frame to its last
constexpr timeval kReadSlice{0, 50'000};     // so that a stalled twin does not delay the daemon's end
constexpr uint64_t kStoodStillUs = 250'000;  // from the end of one call to that of the next
constexpr uint32_t kVersion = 1;
constexpr std::array kTwin{'R', 'F', 'T', 'C'};
constexpr std::array kRecording{'R', 'F', 'R', 'C'};
constexpr std::array kSimulatedRecording{'R', 'F', 'R', 'S'};
constexpr uint32_t kMaxNameBytes = 256;
constexpr uint64_t kMicrosecondsMillihertz = 1'000'000'000;  // a period at 1 mHz
constexpr uint32_t kMinRateMhz = 100;                        // as board.toml's
constexpr uint32_t kMaxRateMhz = 1'000'000;

static_assert(std::endian::native == std::endian::little, "the socket's numbers are read as they are");

struct Greeting {
  std::array<char, 4> magic;
  uint32_t version;
  uint32_t width_px;
  uint32_t height_px;
  uint32_t rate_mhz;
  uint32_t n_name;
};

struct FrameHeader {
  std::array<char, 4> magic;
  uint32_t n_bytes;
  uint64_t number;
};
static_assert(sizeof(Greeting) == 24 && sizeof(FrameHeader) == 16, "as sent, without padding");

// Words of the messages about a sender.
struct SenderWords {
  const char* scheme;
  const char* name;
  const char* command;  // that starts it
};

SenderWords words_of(FrameSender sender) {
  return sender == FrameSender::kTwin ? SenderWords{"twin:", "twin", "`ruffini sim serve`"}
                                      : SenderWords{"frames:", "recording", "`ruffini live`"};
}

enum class ReadStatus { kDone, kNothing, kBroken };

// Fills `out`. Returns kNothing if not even the first byte arrived within a slice and `may_wait` is false.
ReadStatus read_all(int fd, std::span<uint8_t> out, bool may_wait) {
  const auto deadline = SteadyClock::now() + kFramePatience;
  size_t n_done = 0;
  while (n_done < out.size()) {
    const ssize_t n = ::recv(fd, out.data() + n_done, out.size() - n_done, 0);
    if (n > 0) {
      n_done += static_cast<size_t>(n);
      continue;
    }
    if (n == 0 || (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR)) return ReadStatus::kBroken;
    if (n_done == 0 && !may_wait) return ReadStatus::kNothing;
    if (SteadyClock::now() > deadline) return ReadStatus::kBroken;
  }
  return ReadStatus::kDone;
}

template <typename T>
std::span<uint8_t> bytes_of(T& value) {
  return {reinterpret_cast<uint8_t*>(&value), sizeof(T)};
}

class TwinCamera : public Camera {
 public:
  TwinCamera(FrameSender sender, UniqueFd socket, std::string path, bool is_simulated, bool is_replay, bool is_lockstep,
             uint64_t rate_mhz, const Clock& clock)
      : words_(words_of(sender)),
        socket_(std::move(socket)),
        path_(std::move(path)),
        is_simulated_(is_simulated),
        is_replay_(is_replay),
        is_lockstep_(is_lockstep),
        rate_mhz_(rate_mhz),
        clock_(clock) {}

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    // Data that waited in the socket while the device was suspended is old, and nothing in it shows that. The device
    // may have been suspended since the last call, or within this one while it waited for a frame.
    const uint64_t before_us = asked_us_ != 0 ? asked_us_ : clock_.now_us();
    const CaptureStatus status = read_frame(buffer);
    asked_us_ = clock_.now_us();
    if (!is_lockstep_ && asked_us_ - before_us > kStoodStillUs) is_behind_ = true;
    if (status == CaptureStatus::kFrame && is_behind_) {
      is_behind_ = has_more();
      return CaptureStatus::kNothing;
    }
    // A signal to stop also interrupts a wait
    if (status == CaptureStatus::kNothing) is_behind_ = is_behind_ && has_more();
    return status;
  }
  [[nodiscard]] std::string problem() const override { return problem_; }
  [[nodiscard]] bool is_simulated() const override { return is_simulated_; }
  [[nodiscard]] bool is_replay() const override { return is_replay_; }

 private:
  CaptureStatus read_frame(FramePool::Buffer& buffer) {
    if (!is_started_ && !start()) return lose("went away before the first frame");
    FrameHeader header;
    const ReadStatus status = read_all(socket_.get(), bytes_of(header), false);
    if (status == ReadStatus::kNothing) return CaptureStatus::kNothing;
    if (status == ReadStatus::kBroken) return lose("went away without an end");
    if (header.magic != std::array{'R', 'F', 'T', 'F'}) return lose("sent something that is no frame");
    if (header.n_bytes == 0) return CaptureStatus::kEnd;
    buffer.number = header.number;
    buffer.capture_us = is_lockstep_ ? header.number * kMicrosecondsMillihertz / rate_mhz_ : clock_.now_us();
    if (header.n_bytes != buffer.pixels.size()) return lose("sent a frame of another size");
    if (read_all(socket_.get(), buffer.pixels, true) != ReadStatus::kDone) return lose("went away within a frame");
    return CaptureStatus::kFrame;
  }

  [[nodiscard]] bool has_more() const {
    char byte = 0;
    return ::recv(socket_.get(), &byte, 1, MSG_PEEK | MSG_DONTWAIT) == 1;
  }

  bool start() {
    const char mode = is_lockstep_ ? 'L' : 'P';
    is_started_ = ::send(socket_.get(), &mode, 1, MSG_NOSIGNAL) == 1;
    return is_started_;
  }

  CaptureStatus lose(const char* what) {
    problem_ = path_ + ": the " + words_.name + " " + what + ": start " + words_.command + " again, then this";
    return CaptureStatus::kEnd;
  }

  SenderWords words_;
  UniqueFd socket_;
  std::string path_;
  std::string problem_;
  bool is_simulated_;
  bool is_replay_;
  bool is_lockstep_;
  uint64_t rate_mhz_;
  const Clock& clock_;
  bool is_started_ = false;
  bool is_behind_ = false;  // the next data was sent while the device was suspended
  uint64_t asked_us_ = 0;   // end of the last call
};

Result<UniqueFd> connect_to(const std::string& path, const SenderWords& words) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof(address.sun_path)) {
    return Error{ErrorKind::kBadInput, std::string("--camera ") + words.scheme + path + ": give the path of the " +
                                           words.name + "'s socket, at most " +
                                           std::to_string(sizeof(address.sun_path) - 1) + " characters"};
  }
  std::memcpy(address.sun_path, path.data(), path.size());
  const auto deadline = SteadyClock::now() + kConnectPatience;
  for (;;) {
    UniqueFd socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (socket && ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0) {
      ::setsockopt(socket.get(), SOL_SOCKET, SO_RCVTIMEO, &kReadSlice, sizeof(kReadSlice));
      return socket;
    }
    if (SteadyClock::now() > deadline) {
      return Error{ErrorKind::kUnavailable, path + ": no " + words.name + " answers (" + std::strerror(errno) +
                                                "): start " + words.command + " first, which serves this socket"};
    }
    std::this_thread::sleep_for(20ms);
  }
}

}  // namespace

Result<std::unique_ptr<Camera>> open_twin(FrameSender sender, const std::string& socket_path, bool is_lockstep,
                                          const BoardSettings& board, const Clock& clock) {
  const SenderWords words = words_of(sender);
  auto socket = connect_to(socket_path, words);
  if (!socket) return socket.error();
  const int fd = socket.value().get();
  const Error no_sender{ErrorKind::kBadInput, socket_path + ": what answers there is not a " + words.name +
                                                  " of this version: start " + words.command + " of the same release"};
  Greeting greeting;
  if (read_all(fd, bytes_of(greeting), true) != ReadStatus::kDone) return no_sender;
  const bool is_simulated = greeting.magic != kRecording;
  const bool is_replay = greeting.magic != kTwin;
  if ((is_replay && is_simulated && greeting.magic != kSimulatedRecording) || greeting.version != kVersion ||
      greeting.n_name > kMaxNameBytes ||
      (is_replay && (greeting.rate_mhz < kMinRateMhz || greeting.rate_mhz > kMaxRateMhz))) {
    return no_sender;
  }
  std::string name(greeting.n_name, '\0');
  if (read_all(fd, {reinterpret_cast<uint8_t*>(name.data()), name.size()}, true) != ReadStatus::kDone) return no_sender;
  if (name != board.name) {
    return Error{ErrorKind::kBadInput, socket_path + ": " + words.name + " of board \"" + name + "\", this is \"" +
                                           board.name + "\": choose the board that fits"};
  }
  if (greeting.width_px != static_cast<uint32_t>(board.camera.width_px) ||
      greeting.height_px != static_cast<uint32_t>(board.camera.height_px)) {
    return Error{ErrorKind::kBadInput,
                 socket_path + ": the " + words.name + "'s frames are " + std::to_string(greeting.width_px) + "x" +
                     std::to_string(greeting.height_px) + ", board \"" + board.name + "\" needs " +
                     std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px)};
  }
  // A twin's frames may alternate at twice its own rate, which `board` has then.
  const uint64_t rate_mhz = is_replay ? greeting.rate_mhz : static_cast<uint64_t>(board.camera.rate_mhz);
  return std::unique_ptr<Camera>(std::make_unique<TwinCamera>(sender, std::move(socket).value(), socket_path,
                                                              is_simulated, is_replay, is_lockstep, rate_mhz, clock));
}

}  // namespace ruffini
