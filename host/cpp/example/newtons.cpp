// Prints the force on the pad as it comes: ruffini_newtons PORT [NUMBER OF FRAMES]
#include <fcntl.h>
#include <poll.h>
#include <ruffini/client.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace client = ruffini::client;

namespace {

constexpr int kReplyMs = 500, kTries = 6, kSilenceMs = 5'000;

// A serial port in raw mode.
class Port {
 public:
  explicit Port(const char* path) : fd_(open(path, O_RDWR | O_NOCTTY)) {
    termios settings{};
    if (fd_ < 0 || tcgetattr(fd_, &settings) != 0) return;
    cfmakeraw(&settings);
    tcsetattr(fd_, TCSANOW, &settings);
    tcflush(fd_, TCIFLUSH);
  }
  Port(const Port&) = delete;
  Port& operator=(const Port&) = delete;
  ~Port() {
    if (fd_ >= 0) close(fd_);
  }

  [[nodiscard]] bool is_open() const { return fd_ >= 0; }

  [[nodiscard]] bool write_all(const client::Bytes& bytes) const {
    for (size_t at = 0; at < bytes.size();) {
      const ssize_t n = write(fd_, &bytes[at], bytes.size() - at);
      if (n <= 0) return false;
      at += static_cast<size_t>(n);
    }
    return true;
  }

  enum class Read { kPacket, kNothing, kLineLost };

  // The next packet. One read may bring several packets: the rest stays for the next call.
  Read next(client::Decoder& decoder, int timeout_ms, client::Packet& packet) {
    while (n_taken_ == packets_.size()) {
      pollfd wait{fd_, POLLIN, 0};
      if (poll(&wait, 1, timeout_ms) == 0) return Read::kNothing;
      uint8_t bytes[4096];
      const ssize_t n = read(fd_, bytes, sizeof bytes);
      if (n <= 0) return Read::kLineLost;
      packets_ = decoder.feed(bytes, static_cast<size_t>(n));
      n_taken_ = 0;
    }
    packet = std::move(packets_[n_taken_++]);
    return Read::kPacket;
  }

 private:
  int fd_;
  std::vector<client::Packet> packets_;
  size_t n_taken_ = 0;
};

// Sends the question until is_answer() accepts a packet; false if the line is lost or no answer comes. Other packets
// that arrive before the answer are dropped.
template <typename IsAnswer>
bool ask(Port& port, client::Decoder& decoder, const client::Bytes& question, IsAnswer is_answer) {
  client::Packet packet;
  for (int i = 0; i < kTries; ++i) {
    if (!port.write_all(question)) return false;
    for (int packets = 0; packets < 256; ++packets) {  // telemetry may come in between
      const auto read = port.next(decoder, kReplyMs, packet);
      if (read == Port::Read::kLineLost) return false;
      if (read == Port::Read::kNothing) break;
      if (is_answer(packet.message)) return true;
    }
  }
  return false;
}

void print(const client::Packet& packet, const client::Wrench& wrench) {
  const auto& f = wrench.force_n;  // NaN where it is not valid
  std::printf("frame %llu  fx %+.3f  fy %+.3f  fz %+.3f N", static_cast<unsigned long long>(wrench.stamp.frame),
              f[0].value, f[1].value, f[2].value);
  if (wrench.stamp.flags != 0) std::printf("  flags %u", wrench.stamp.flags);
  std::printf("%s\n", packet.is_simulated ? "  SIMULATED" : "");
}

int fail(const char* port, const char* what) {
  std::fprintf(stderr, "%s: %s\n", port, what);
  return 3;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: ruffini_newtons PORT [NUMBER OF FRAMES]\n");
    return 2;
  }
  Port port(argv[1]);
  if (!port.is_open()) return fail(argv[1], std::strerror(errno));
  client::Decoder decoder;
  client::Encoder encoder(std::random_device{}() | 1U);

  client::Hello hello;
  const bool is_there = ask(port, decoder, encoder.hello(), [&](const client::Message& message) {
    const auto* said = std::get_if<client::Hello>(&message);
    if (said != nullptr) hello = *said;
    return said != nullptr;
  });
  if (!is_there) return fail(argv[1], "nothing answers HELLO: is ruffinid running, and is it this port?");
  for (const auto& sensor : hello.sensors) {
    std::fprintf(stderr, "%s: %s %s, %s\n", argv[1], sensor.product.c_str(), hello.device_serial.c_str(),
                 sensor.is_calibrated ? "calibrated" : "no calibration: forces are NaN");
  }

  std::string refusal;
  const client::Bytes wish = encoder.subscribe({{client::Type::kWrench, 1}});
  const bool is_subscribed = ask(port, decoder, wish, [&](const client::Message& message) {
    const auto* reply = std::get_if<client::Reply>(&message);
    if (reply == nullptr || reply->request_id != encoder.request_id()) return false;
    if (reply->code != 0) refusal = reply->text;
    return true;
  });
  if (!is_subscribed || !refusal.empty()) return fail(argv[1], refusal.empty() ? "no reply" : refusal.c_str());

  long n_left = argc > 2 ? std::strtol(argv[2], nullptr, 10) : -1;
  while (n_left != 0) {
    client::Packet packet;
    const auto read = port.next(decoder, kSilenceMs, packet);
    if (read == Port::Read::kLineLost) return fail(argv[1], "the line was lost");
    if (read == Port::Read::kNothing) return fail(argv[1], "no frame for five seconds: does the camera stand still?");
    const auto* wrench = std::get_if<client::Wrench>(&packet.message);
    if (wrench == nullptr) continue;
    print(packet, *wrench);
    --n_left;
  }
  const auto& n = decoder.counters();
  std::fprintf(stderr, "%llu damaged frames, %llu messages lost\n",
               static_cast<unsigned long long>(n.bad_crc + n.malformed + n.oversize),
               static_cast<unsigned long long>(n.lost));
  return 0;
}
