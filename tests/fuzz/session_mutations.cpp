// Hostile bytes on the line: through the real decoder, session, calibrator and frame path.
//
//   ruffini_fuzz_session VECTORS [N]
//
// N mutants in all (default 1,000,000), then 1 MB of noise:
//   - half are valid host frames and the vectors of the file VECTORS (proto/vectors/frames.txt), mutated on the line;
//   - half are commands mutated inside a frame that is right, so that they reach the parser and the session;
//   - one in 500 is a calibration file, mutated and then signed, that is uploaded whole; where the device takes it
//     into force, frames are computed with it and every message is sent.
// Everything that the session says must be whole frames, HELLO must be answered after each thousand, and no
// more may wait for a host that does not read than the session promises. Run under ASan and UBSan.
// Deterministic: the seeds are fixed.
#include <pb_encode.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "hw/system.h"
#include "link/messages.h"
#include "link/session.h"
#include "mutator.h"
#include "support/dot_picture.h"
#include "support/signed_calibration.h"
#include "support/test_board.h"
#include "support/test_calibration.h"

namespace ruffini {
namespace {

using fuzz::Bytes;
using fuzz::Mutator;

constexpr int kNoiseBytes = 1'000'000;
constexpr int kDrainEvery = 32;  // below the 64 replies that the session keeps
constexpr int kHelloEvery = 1'000;
constexpr int kUploadEvery = 500;
constexpr size_t kMaxBacklogBytes = 4'000'000;  // what the device may hold back for a host that does not read

[[noreturn]] void fail(const std::string& why) {
  std::fprintf(stderr, "fuzz: %s\n", why.c_str());
  std::exit(1);
}

Bytes host_frame(uint8_t type, const Bytes& payload, uint8_t sensor = kDeviceSensor, uint8_t n_fragments = 1) {
  std::array<uint8_t, kMaxFrameBytes> frame;
  const size_t n = encode_frame({kFromHost, type, sensor, 0, 0, n_fragments}, payload, frame);
  return {frame.begin(), frame.begin() + static_cast<ptrdiff_t>(n)};
}

Bytes serialize_message(const ruffini_Command& message) {
  Bytes payload(ruffini_Command_size);
  pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
  if (!pb_encode(&stream, ruffini_Command_fields, &message)) fail("a command cannot be encoded");
  payload.resize(stream.bytes_written);
  return payload;
}

ruffini_Command of_kind(pb_size_t action) {
  ruffini_Command m = ruffini_Command_init_zero;
  m.which_action = action;
  return m;
}

// One command of every kind, serialize_message.
std::vector<Bytes> command_payloads() {
  ruffini_Command subscribe = of_kind(ruffini_Command_subscribe_tag);
  subscribe.action.subscribe.subscriptions_count = 3;
  for (uint32_t i = 0; i < 3; ++i) {
    subscribe.action.subscribe.subscriptions[i] = {static_cast<ruffini_MessageType>(4 + i), i + 1};
  }
  ruffini_Command zero = of_kind(ruffini_Command_zero_tag);
  zero.action.zero.n_frames = 5;
  ruffini_Command get = of_kind(ruffini_Command_get_tag);
  std::snprintf(get.action.get.key, sizeof get.action.get.key, "frames_processed");
  ruffini_Command set = of_kind(ruffini_Command_set_tag);
  set.action.set.value = -1;
  ruffini_Command begin = of_kind(ruffini_Command_flash_begin_tag);
  begin.action.flash_begin.size_bytes = 100;
  begin.action.flash_begin.sha256.size = 32;
  ruffini_Command chunk = of_kind(ruffini_Command_flash_chunk_tag);
  chunk.action.flash_chunk.data.size = 100;
  std::vector<Bytes> out;
  for (const ruffini_Command& m : {subscribe, zero, get, set, begin, chunk, of_kind(ruffini_Command_flash_commit_tag),
                                   of_kind(ruffini_Command_flash_abort_tag), of_kind(ruffini_Command_flash_undo_tag),
                                   of_kind(ruffini_Command_flash_query_tag), of_kind(ruffini_Command_challenge_tag),
                                   of_kind(ruffini_Command_lease_tag), of_kind(ruffini_Command_flash_read_tag)}) {
    out.push_back(serialize_message(m));
  }
  return out;
}

std::vector<Bytes> read_vectors(const std::string& path) {
  std::ifstream in(path);
  if (!in) fail(path + " cannot be read");
  std::vector<Bytes> out;
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line[0] == '#') continue;
    const size_t begin = line.find(" | ") + 3;
    Bytes bytes;
    for (size_t i = begin; i + 1 < line.find(" | ", begin); i += 2) {
      bytes.push_back(static_cast<uint8_t>(std::strtoul(line.substr(i, 2).c_str(), nullptr, 16)));
    }
    out.push_back(bytes);
  }
  if (out.empty()) fail(path + " holds no vectors");
  return out;
}

BoardSettings small_board() {
  BoardSettings board = test::round_board();
  board.stages = test::stages_but({});
  board.grid = {5, 4};
  return board;
}

// The device, and the host's ear: whatever the session says goes through drain().
class Device {
 public:
  Device()
      : board_(small_board()),
        path_(FramePath::configure(board_, nullptr, [] { return uint64_t{0}; }).value()),
        calibrator_(board_, "0000", SlotStore::open(folder_).value(), exchange_),
        session_(board_, *path_, {.serial = "0000", .version = "fuzz"}, calibrator_, exchange_, {clock_, random_}),
        encoder_(*path_, 0) {
    std::string problem;
    if (!calibrator_.start([] { return uint64_t{0}; }, problem)) fail(problem);
  }
  ~Device() {
    delete exchange_.next_path.load();
    delete exchange_.retired_path.load();
    std::filesystem::remove_all(folder_);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  void receive(const Bytes& bytes) { session_.receive(bytes); }

  // Reads all that waits; counts replies.
  void drain() {
    session_.poll(now_us_ += 1'000);
    size_t n = 0;
    for (auto out = session_.pending(); !out.empty(); out = session_.pending()) {
      n += out.size();
      if (n > kMaxBacklogBytes) fail("the session holds more than " + std::to_string(kMaxBacklogBytes) + " bytes");
      for (const uint8_t byte : out) hear(byte);
      session_.consumed(out.size());
    }
    const DecoderCounters& bad = ear_.counters();
    if (bad.bad_crc + bad.malformed + bad.oversize != 0) fail("the session said something that is no frame");
  }

  void check_hello() {
    drain();
    const uint64_t before = n_hellos_;
    session_.receive(Bytes{0});  // ends whatever a mutant began
    session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO, {}));
    drain();
    if (n_hellos_ == before) fail("HELLO is not answered any more");
  }

  void upload(const Bytes& file) {
    ruffini_Command begin = of_kind(ruffini_Command_flash_begin_tag);
    begin.action.flash_begin.size_bytes = file.size();
    const std::string hash = sha256(file);
    begin.action.flash_begin.sha256.size = static_cast<pb_size_t>(hash.size());
    std::copy(hash.begin(), hash.end(), begin.action.flash_begin.sha256.bytes);
    command(begin);
    ruffini_Command chunk = of_kind(ruffini_Command_flash_chunk_tag);
    for (size_t at = 0; at < file.size(); at += Calibrator::kMaxChunkBytes) {
      const size_t n = std::min(Calibrator::kMaxChunkBytes, file.size() - at);
      chunk.action.flash_chunk.offset = at;
      chunk.action.flash_chunk.data.size = static_cast<pb_size_t>(n);
      std::copy_n(file.begin() + static_cast<ptrdiff_t>(at), n, chunk.action.flash_chunk.data.bytes);
      command(chunk);
    }
    command(of_kind(ruffini_Command_flash_commit_tag));
    use_calibration();
  }

  [[nodiscard]] uint64_t n_hellos() const { return n_hellos_; }
  [[nodiscard]] uint64_t n_replies() const { return n_replies_; }
  [[nodiscard]] uint64_t n_in_force() const { return n_in_force_; }
  [[nodiscard]] uint64_t n_trials_ended() const { return n_trials_ended_; }

 private:
  void hear(uint8_t byte) {
    const auto frame = ear_.push(byte);
    if (!frame) return;
    if (frame->header.type == ruffini_MessageType_MESSAGE_TYPE_HELLO) ++n_hellos_;
    if (frame->header.type == ruffini_MessageType_MESSAGE_TYPE_REPLY) ++n_replies_;
  }

  void command(ruffini_Command m) {
    m.request_id = ++upload_id_;
    session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, serialize_message(m)));
    drain();
  }

  // As the frame thread would: swap the path in, look at the rested and the pressed pad, send everything.
  void use_calibration() {
    FramePath* next = exchange_.next_path.exchange(nullptr);
    if (next == nullptr) return;
    ++n_in_force_;
    delete exchange_.retired_path.exchange(path_.release());
    path_.reset(next);
    for (int i = 0; i < board_.n_rest_frames; ++i) path_->process(view(rest_));
    path_->process(view(pressed_));
    for (uint8_t type = 0; type < kMessageTypes; ++type) {
      encoder_.encode(static_cast<ruffini_MessageType>(type), *path_, view(pressed_), {},
                      [&](ruffini_MessageType, std::span<const uint8_t> frames) {
                        if (!exchange_.push_telemetry({0, type}, frames)) fail("the telemetry ring is full");
                      });
    }
    // Trials end well, end badly, and are still running when the next file comes.
    if (n_in_force_ % 3 != 0)
      exchange_.tally = {path_->calibration_id(), 256, static_cast<uint16_t>(n_in_force_ % 3 == 1 ? 256 : 0)};
    drain();
    if (!calibrator_.is_on_trial()) ++n_trials_ended_;
  }

  [[nodiscard]] FrameView view(const Bytes& pixels) const {
    return {pixels.data(), board_.camera.width_px, board_.camera.height_px, 3, ptrdiff_t{3} * board_.camera.width_px};
  }
  [[nodiscard]] Bytes picture(double moved_px) const {
    auto dots = test::nominal_dots(board_);
    for (test::Place& p : dots) p.x += moved_px;
    Bytes out = test::DotPicture{}.bgr(dots, 1);
    for (size_t i = 0; i < out.size(); i += 7) out[i] = static_cast<uint8_t>(out[i] + moved_px * 10);
    return out;
  }

  BoardSettings board_;
  std::string folder_ =
      (std::filesystem::temp_directory_path() / ("ruffini-fuzz-store" + std::to_string(::getpid()))).string();
  std::unique_ptr<FramePath> path_;
  Exchange exchange_;
  Calibrator calibrator_;
  SystemClock clock_;
  SystemRandom random_;
  Session session_;
  MessageEncoder encoder_;
  Bytes rest_ = picture(0);
  Bytes pressed_ = picture(3);
  FrameDecoder ear_;
  uint64_t now_us_ = 0;
  uint32_t upload_id_ = 0x8000'0000;
  uint64_t n_hellos_ = 0;
  uint64_t n_replies_ = 0;
  uint64_t n_in_force_ = 0;
  uint64_t n_trials_ended_ = 0;
};

// A mutated command in a frame that is right, under a number of its own: a repeated one would not be run.
Bytes sealed(Mutator& mutator, int i) {
  Bytes payload = mutator.next();
  payload.resize(std::min(payload.size(), kMaxPayloadBytes - 6));
  payload.push_back(0x08);  // request_id, once more: the last one counts
  for (auto id = static_cast<uint32_t>(i); true; id >>= 7) {
    payload.push_back(static_cast<uint8_t>(id < 0x80 ? id : (id & 0x7F) | 0x80));
    if (id < 0x80) break;
  }
  const uint8_t type = mutator.below(8) != 0 ? uint8_t{ruffini_MessageType_MESSAGE_TYPE_COMMAND} : mutator.byte();
  const uint8_t sensor = mutator.below(8) != 0 ? kDeviceSensor : mutator.byte();
  const auto n_fragments = static_cast<uint8_t>(mutator.below(16) != 0 ? 1 : 1 + mutator.below(255));
  return host_frame(type, payload, sensor, n_fragments);
}

int run(const std::string& vectors, int n_mutants) {
  std::vector<Bytes> lines = read_vectors(vectors);
  const std::vector<Bytes> commands = command_payloads();
  for (const Bytes& payload : commands) {
    lines.push_back(host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, payload));
  }
  const size_t n_seeds = lines.size();
  Mutator on_the_line(std::move(lines), 1);
  Mutator inside(commands, 2);
  Mutator files({test::diagonal_calibration(small_board())}, 3);
  Device device;
  int n_uploads = 0;
  for (int i = 0; i < n_mutants; ++i) {
    if (i % kUploadEvery == 0) {
      Bytes file = files.next();
      file.resize(std::max<size_t>(file.size(), 64));  // room for a signature
      device.upload(test::sign(std::move(file)));
      ++n_uploads;
    } else if (i % 2 == 0) {
      Bytes bytes = on_the_line.next();
      if (on_the_line.below(8) != 0) bytes.push_back(0);  // most are whole frames, some run into the next one
      device.receive(bytes);
    } else {
      device.receive(sealed(inside, i));
    }
    if (i % kDrainEvery == 0) device.drain();
    if (i % kHelloEvery == 0) device.check_hello();
  }
  Bytes noise(kNoiseBytes);
  std::generate(noise.begin(), noise.end(), [&] { return on_the_line.byte(); });
  device.receive(noise);
  device.check_hello();
  // Were hardly any command understood, or no file taken, this would prove little.
  if (device.n_replies() < static_cast<uint64_t>(n_mutants) / 20 || (n_uploads > 100 && device.n_trials_ended() == 0)) {
    fail("too few of the mutants reach the session: " + std::to_string(device.n_replies()) + " replies, " +
         std::to_string(device.n_in_force()) + " files in force");
  }
  std::printf(
      "%d mutants of %zu seeds: %llu commands answered, %llu of %d mutated calibrations in force; %d bytes of "
      "noise; HELLO answered %llu times\n",
      n_mutants, n_seeds, static_cast<unsigned long long>(device.n_replies()),
      static_cast<unsigned long long>(device.n_in_force()), n_uploads, kNoiseBytes,
      static_cast<unsigned long long>(device.n_hellos()));
  return 0;
}

}  // namespace
}  // namespace ruffini

int main(int argc, char** argv) {
  if (argc < 2 || argc > 3) {
    std::fprintf(stderr, "usage: ruffini_fuzz_session VECTORS [N]\n");
    return 2;
  }
  return ruffini::run(argv[1], argc > 2 ? std::atoi(argv[2]) : 1'000'000);
}
