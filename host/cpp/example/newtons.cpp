// Prints force and contacts as they arrive, and reconnects: ruffini_newtons PORT [NUMBER OF FRAMES]
#include <fcntl.h>
#include <poll.h>
#include <ruffini/client.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

namespace client = ruffini::client;

namespace {

constexpr int kTries = 6;
constexpr double kTickS = 1.0 / 60;  // period of the control loop
constexpr double kReplyS = 0.5;      // a question is repeated if there is no reply
constexpr double kTimeS = 1.0;       // between two exchanges of TIME
constexpr double kDrift = 3e-4;      // of the clocks, at most
constexpr double kTimeOldS = 5.0;    // the clock's error is unknown if TIME was not answered for so long
constexpr double kSilenceS = 3.0;    // STATUS comes once a second: without it line or subscription is gone
constexpr double kNoFrameS = 5.0;    // until a stalled camera is reported
constexpr double kAwayS = 10.0;      // until the program gives up on a lost line

// Limits of this program. Yours follow from the robot's speed and from the force that does harm.
constexpr double kMaxAgeS = 0.1, kMaxSigmaN = 0.05;

// True if the forces along `axes` (0 x, 1 y, 2 z) may be used for control. `age_s`: since mid-exposure, with its error.
bool is_usable(const client::Wrench& wrench, const std::vector<size_t>& axes, double age_s, bool is_line_unfit,
               uint32_t health) {
  constexpr uint32_t kOtherAxes = client::kFlagUncalibratedXy | client::kFlagUncalibratedZ;  // their axes are not VALID
  constexpr uint32_t kNotOfForces = client::kHealthDevelopmentKey | client::kHealthLinkDegraded |
                                    client::kHealthNetwork | client::kHealthReflex | client::kHealthThrottled |
                                    client::kHealthCrashed;
  if (is_line_unfit || !(age_s <= kMaxAgeS) || !wrench.covariance) return false;
  if ((wrench.stamp.flags & ~kOtherAxes) != 0 || (health & ~kNotOfForces) != 0) return false;
  return std::all_of(axes.begin(), axes.end(), [&](size_t i) {
    return wrench.force_n[i].validity == client::Validity::kValid &&
           std::sqrt((*wrench.covariance)[i][i]) <= kMaxSigmaN;
  });
}

double now_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

// A serial port in raw mode, and the packets that arrive on it.
class Port {
 public:
  explicit Port(const char* path) : fd_(open(path, O_RDWR | O_NOCTTY | O_NONBLOCK)) {
    termios settings{};
    if (fd_ < 0 || tcgetattr(fd_, &settings) != 0) return;
    if (!is_pty()) ioctl(fd_, TIOCEXCL);  // another program would replace this one's subscription
    cfmakeraw(&settings);
    tcsetattr(fd_, TCSANOW, &settings);
    tcflush(fd_, TCIFLUSH);
  }
  Port(const Port&) = delete;
  Port& operator=(const Port&) = delete;
  ~Port() {
    if (fd_ < 0) return;
    ioctl(fd_, TIOCNXCL);
    tcflush(fd_, TCOFLUSH);  // else close() waits for a dead line
    close(fd_);
  }

  [[nodiscard]] bool is_open() const { return fd_ >= 0; }
  [[nodiscard]] const client::Counters& counters() const { return decoder_.counters(); }

  [[nodiscard]] bool write_all(const client::Bytes& bytes) const {
    for (size_t at = 0; at < bytes.size();) {
      const ssize_t n = write(fd_, &bytes[at], bytes.size() - at);
      if (n > 0) {
        at += static_cast<size_t>(n);
        continue;
      }
      pollfd wait{fd_, POLLOUT, 0};
      if (n == 0 || errno != EAGAIN || poll(&wait, 1, static_cast<int>(1e3 * kTickS)) <= 0) return false;
    }
    return true;
  }

  enum class Read { kPacket, kNothing, kLineLost };

  // The next packet. One read may bring several packets: the rest stays for the next call.
  Read next(double timeout_s, client::Packet& packet) {
    const double end_s = now_s() + timeout_s;
    while (n_taken_ == packets_.size()) {
      pollfd wait{fd_, POLLIN, 0};
      const int n_ready = poll(&wait, 1, static_cast<int>(1e3 * std::max(end_s - now_s(), 0.0)));
      if (n_ready == 0) return Read::kNothing;
      if (n_ready < 0 && errno == EINTR) continue;
      if (n_ready < 0) return Read::kLineLost;
      uint8_t bytes[4096];
      const ssize_t n = read(fd_, bytes, sizeof bytes);
      if (n < 0 && (errno == EAGAIN || errno == EINTR)) continue;
      if (n <= 0) return Read::kLineLost;
      packets_ = decoder_.feed(bytes, static_cast<size_t>(n));
      n_taken_ = 0;
    }
    packet = std::move(packets_[n_taken_++]);
    return Read::kPacket;
  }

 private:
  // A pseudo-terminal stays exclusive after it was closed.
  [[nodiscard]] bool is_pty() const {
    const char* name = ttyname(fd_);
    return name != nullptr && std::string(name).rfind("/dev/pts/", 0) == 0;
  }

  int fd_;
  client::Decoder decoder_;
  std::vector<client::Packet> packets_;
  size_t n_taken_ = 0;
};

// Sends the question until is_answer() accepts a packet; false if the line is lost or no answer comes. Other packets
// that arrive before the answer are dropped.
template <typename IsAnswer>
bool ask(Port& port, const client::Bytes& question, IsAnswer is_answer) {
  client::Packet packet;
  for (int i = 0; i < kTries; ++i) {
    if (!port.write_all(question)) return false;
    const double end_s = now_s() + kReplyS;
    while (now_s() < end_s) {  // telemetry may come in between
      const auto read = port.next(end_s - now_s(), packet);
      if (read == Port::Read::kLineLost) return false;
      if (read == Port::Read::kPacket && is_answer(packet.message)) return true;
    }
  }
  return false;
}

// Prints the results of one sensor. All but the port outlives a reconnection.
class Printer {
 public:
  Printer(const char* path, long n_frames) : path_(path), n_left_(n_frames) {}

  [[nodiscard]] bool is_done() const { return n_left_ == 0; }
  [[nodiscard]] bool was_connected() const { return !hello_.sensors.empty() || !hello_.device_serial.empty(); }

  // HELLO, then SUBSCRIBE. Returns the problem; empty: none.
  std::string connect(Port& port) {
    damage_.begin_decoder();
    if (!port.is_open()) return std::strerror(errno);
    client::Hello hello;
    const bool is_there = ask(port, encoder_.ask_hello(), [&](const client::Message& message) {
      const auto* answer = std::get_if<client::Hello>(&message);
      if (answer != nullptr) hello = *answer;
      return answer != nullptr;
    });
    if (!is_there) return "nothing answers HELLO: is ruffinid running, and is it this port?";
    if (was_connected() && hello.device_serial != hello_.device_serial) return "another sensor: " + hello.device_serial;
    hello_ = hello;
    for (const auto& sensor : hello.sensors) {
      std::fprintf(stderr, "%s: %s %s, %s%s\n", path_, sensor.product.c_str(), hello.device_serial.c_str(),
                   sensor.is_calibrated ? "calibrated" : "no calibration: forces are NaN",
                   sensor.is_on_trial ? ", on trial" : "");
    }
    std::string refusal;
    const client::Bytes wish =
        encoder_.subscribe({{client::Type::kWrench, 1}, {client::Type::kContacts, 1}, {client::Type::kStatus, 1}});
    const bool is_subscribed = ask(port, wish, [&](const client::Message& message) {
      const auto* reply = std::get_if<client::Reply>(&message);
      if (reply == nullptr || reply->request_id != encoder_.request_id()) return false;
      if (reply->code != client::kReplyOk) refusal = reply->text;
      return true;
    });
    return is_subscribed ? refusal : "no answer to the subscription";
  }

  // Call after each packet, and after connect(), which reads some itself.
  void watch_damage(const Port& port) {
    if (!damage_.update(port.counters().damaged(), now_s())) return;
    std::fprintf(stderr,
                 "%s: two damaged frames within six minutes: not for control until six minutes have passed with at "
                 "most one; see "
                 "the cable\n",
                 path_);
  }

  // Prints until the line is lost, or all frames have come. Each turn of the loop is one tick of a controller.
  void print_all(Port& port) {
    clock_error_s_ = client::kNaN;  // after a restart the device's clock begins elsewhere
    health_ = ~0U;                  // unknown until STATUS
    double tick_s = now_s(), time_s = 0.0;
    frame_s_ = status_s_ = now_s();
    bool is_stalled = false;
    while (!is_done()) {
      if (now_s() - time_s >= kTimeS) {
        time_s = asked_s_ = now_s();
        if (!port.write_all(encoder_.ask_time(++token_))) return lose();
      }
      tick_s = std::max(tick_s + kTickS, now_s());
      if (!take_all(port, tick_s) || now_s() - status_s_ > kSilenceS) return lose();
      judge();
      if (is_stalled != (now_s() - frame_s_ > kNoFrameS)) {
        is_stalled = !is_stalled;
        std::fprintf(stderr, "%s: %s\n", path_,
                     is_stalled ? "no new frame for five seconds: see the camera's cable" : "frames come again");
      }
    }
    const auto& n = port.counters();
    std::fprintf(stderr, "%llu damaged frames, %llu messages lost\n", static_cast<unsigned long long>(n.damaged()),
                 static_cast<unsigned long long>(n.lost));
  }

 private:
  // Prints what arrives until `end_s`; false if the line is lost.
  bool take_all(Port& port, double end_s) {
    while (!is_done()) {
      client::Packet packet;
      const auto read = port.next(end_s - now_s(), packet);
      watch_damage(port);
      if (read != Port::Read::kPacket) return read == Port::Read::kNothing;
      if (print(packet)) frame_s_ = now_s();
      if (now_s() > end_s) return true;  // more is there: at the next tick
    }
    return true;
  }

  // The last force is of no use any more: after a restart its time of capture is on another clock.
  void lose() {
    wrench_ = client::Wrench{};
    judge();
    std::fprintf(stderr, "%s: the line was lost\n", path_);
  }

  // True for a new frame's WRENCH. While the camera delivers nothing, the last one is repeated with kFlagStale.
  bool print(const client::Packet& packet) {
    const char* simulated = packet.is_simulated ? "  SIMULATED" : "";
    if (const auto* time = std::get_if<client::Time>(&packet.message); time != nullptr && time->token == token_) {
      const double answered_s = now_s();
      const double received_s = 1e-6 * static_cast<double>(time->received_us);
      const double sent_s = 1e-6 * static_cast<double>(time->sent_us);
      host_minus_device_s_ = (asked_s_ + answered_s - received_s - sent_s) / 2;
      clock_error_s_ = (answered_s - asked_s_ - (sent_s - received_s)) / 2;
      answered_s_ = answered_s;
    }
    if (const auto* event = std::get_if<client::Event>(&packet.message)) {
      std::fprintf(stderr, "%s: %s: %s\n", path_, event->what.c_str(), event->text.c_str());
    }
    if (const auto* status = std::get_if<client::Status>(&packet.message)) {
      if (status->health != health_) std::fprintf(stderr, "%s: health %u\n", path_, status->health);
      health_ = status->health;
      status_s_ = now_s();
    }
    if (const auto* contacts = std::get_if<client::Contacts>(&packet.message)) {
      for (const auto& contact : contacts->contacts) {
        std::printf("frame %llu  contact %u at %+.1f %+.1f mm  fz %+.3f N%s\n", number(contacts->stamp), contact.id,
                    1e3 * contact.center_m[0], 1e3 * contact.center_m[1], contact.force_n[2].value, simulated);
      }
    }
    const auto* wrench = std::get_if<client::Wrench>(&packet.message);
    if (wrench == nullptr) return false;
    const auto& f = wrench->force_n;  // NaN where it is not VALID
    std::printf("frame %llu  fx %+.3f  fy %+.3f  fz %+.3f N", number(wrench->stamp), f[0].value, f[1].value,
                f[2].value);
    if (wrench->covariance) std::printf("  sigma of fz %.3f N", std::sqrt((*wrench->covariance)[2][2]));
    if (wrench->stamp.flags != 0) std::printf("  flags %u", wrench->stamp.flags);
    wrench_ = *wrench;
    was_usable_ = is_for_control();
    std::printf("%s%s\n", was_usable_ ? "  usable" : "  not for control", simulated);
    std::fflush(stdout);
    if ((wrench->stamp.flags & client::kFlagStale) != 0) return false;
    if (n_left_ > 0) --n_left_;
    return true;
  }

  // True if the last force may be used now: its age grows while nothing arrives.
  [[nodiscard]] bool is_for_control() const {
    const double captured_s = 1e-6 * static_cast<double>(wrench_.stamp.capture_us) + host_minus_device_s_;
    const double since_s = now_s() - answered_s_;
    const double error_s = since_s < kTimeOldS ? clock_error_s_ + kDrift * since_s : client::kNaN;
    return is_usable(wrench_, {2}, now_s() - captured_s + error_s, damage_.is_unfit(now_s()), health_);
  }

  // Call at every tick, not only when a frame arrives.
  void judge() {
    if (!was_usable_ || is_for_control()) return;
    was_usable_ = false;
    std::fprintf(stderr, "%s: no usable force any more: hold still\n", path_);
  }

  static unsigned long long number(const client::Stamp& stamp) { return stamp.frame; }

  const char* path_;
  long n_left_;  // negative: no limit
  client::Encoder encoder_{std::random_device{}() | 1U};
  client::DamageWatch damage_;
  client::Hello hello_;
  client::Wrench wrench_;    // the last one
  bool was_usable_ = false;  // at the last tick
  uint32_t health_ = ~0U;
  uint64_t token_ = 0;
  double frame_s_ = 0.0, status_s_ = 0.0;  // when the last new frame and the last STATUS came
  double asked_s_ = 0.0, answered_s_ = 0.0, host_minus_device_s_ = 0.0;
  double clock_error_s_ = client::kNaN;  // NaN: the age of a frame is not known yet
};

int fail(const char* port, const std::string& what) {
  std::fprintf(stderr, "%s: %s\n", port, what.c_str());
  return 3;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: ruffini_newtons PORT [NUMBER OF FRAMES]\n");
    return 2;
  }
  Printer printer(argv[1], argc > 2 ? std::strtol(argv[2], nullptr, 10) : -1);
  double connected_s = 0.0;
  while (!printer.is_done()) {
    Port port(argv[1]);  // /dev/ruffini/SERIAL finds it at any USB port
    std::string problem = printer.connect(port);
    printer.watch_damage(port);
    if (problem.empty()) {
      printer.print_all(port);
      connected_s = now_s();
    } else if (!printer.was_connected() || now_s() - connected_s > kAwayS) {
      return fail(argv[1], problem);
    } else {
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
  }
  return 0;
}
