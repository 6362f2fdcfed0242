// Hostile bytes on the line: mutated host frames and noise through the real decoder and session.
//
//   ruffini_fuzz_session BOARD_FOLDER VECTORS [N]
//
// Every valid host message, and every vector of the file VECTORS (proto/vectors/frames.txt), is mutated N times in
// all (default 1,000,000), then 1 MB of noise follows. The session must go on answering HELLO, checked after
// each thousand, and must never answer with more memory than it is asked for. Run under ASan and UBSan.
// Deterministic: the seeds are fixed.
#include <pb_encode.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "board/parse.h"
#include "link/messages.h"
#include "link/session.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

constexpr int kNoiseBytes = 1'000'000;
constexpr int kCheckEvery = 1'000;
constexpr size_t kMaxBacklogBytes = 4'000'000;  // what the device may hold back for a host that does not read

[[noreturn]] void fail(const std::string& why) {
  std::fprintf(stderr, "fuzz: %s\n", why.c_str());
  std::exit(1);
}

Bytes host_frame(ruffini_MessageType type, const Bytes& payload, uint32_t sequence) {
  Bytes out(frames_bound(payload.size()));
  out.resize(write_frames(type, kFromHost, kDeviceSensor, sequence, payload, out));
  return out;
}

Bytes command(const ruffini_Command& message, uint32_t sequence) {
  Bytes payload(ruffini_Command_size);
  pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
  if (!pb_encode(&stream, ruffini_Command_fields, &message)) fail("a command cannot be encoded");
  payload.resize(stream.bytes_written);
  return host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, payload, sequence);
}

// One frame of every message that a host sends, and one command of every kind.
std::vector<Bytes> host_messages() {
  std::vector<Bytes> out;
  uint32_t n = 0;
  for (const auto type : {ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_MessageType_MESSAGE_TYPE_SCHEMA,
                          ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_MessageType_MESSAGE_TYPE_WRENCH}) {
    out.push_back(host_frame(type, {}, n++));
  }
  ruffini_Command m = ruffini_Command_init_zero;
  const auto add = [&](pb_size_t action) {
    m.request_id = ++n;
    m.which_action = action;
    out.push_back(command(m, n));
    m = ruffini_Command_init_zero;
  };
  m.action.subscribe.subscriptions_count = 3;
  for (uint32_t i = 0; i < 3; ++i) {
    m.action.subscribe.subscriptions[i] = {static_cast<ruffini_MessageType>(4 + i), i + 1};
  }
  add(ruffini_Command_subscribe_tag);
  m.action.zero.n_frames = 5;
  add(ruffini_Command_zero_tag);
  std::snprintf(m.action.get.key, sizeof m.action.get.key, "frames_processed");
  add(ruffini_Command_get_tag);
  m.action.set.value = -1;
  add(ruffini_Command_set_tag);
  m.action.flash_begin.size_bytes = 100;
  m.action.flash_begin.sha256.size = 32;
  add(ruffini_Command_flash_begin_tag);
  m.action.flash_chunk.data.size = 100;
  add(ruffini_Command_flash_chunk_tag);
  add(ruffini_Command_flash_commit_tag);
  add(ruffini_Command_flash_abort_tag);
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

class Mutator {
 public:
  explicit Mutator(std::vector<Bytes> seeds) : seeds_(std::move(seeds)) {}

  Bytes next() {
    Bytes bytes = seeds_[below(seeds_.size())];
    for (size_t n = 1 + below(4); n > 0; --n) mutate(bytes);
    if (below(8) != 0) bytes.push_back(0);  // most mutants are whole frames, some run into the next one
    return bytes;
  }
  uint8_t byte() { return static_cast<uint8_t>(random_()); }

 private:
  size_t below(size_t n) { return static_cast<size_t>(random_()) % n; }

  void mutate(Bytes& bytes) {
    if (bytes.empty()) {
      bytes.push_back(byte());
      return;
    }
    const size_t at = below(bytes.size());
    const auto place = bytes.begin() + static_cast<ptrdiff_t>(at);
    switch (below(7)) {
      case 0:
        bytes[at] ^= static_cast<uint8_t>(1U << below(8));
        break;
      case 1:
        bytes[at] = byte();
        break;
      case 2:
        bytes.insert(place, byte());
        break;
      case 3:
        bytes.erase(place);
        break;
      case 4:
        bytes.resize(at);
        break;
      case 5: {
        const Bytes& other = seeds_[below(seeds_.size())];
        bytes.resize(at);
        bytes.insert(bytes.end(), other.begin() + static_cast<ptrdiff_t>(below(other.size())), other.end());
        break;
      }
      default: {
        const Bytes copy = bytes;
        bytes.insert(bytes.end(), copy.begin(), copy.end());
      }
    }
  }

  std::vector<Bytes> seeds_;
  std::mt19937_64 random_{20'261'121};
};

// The inverse of what makes a frame invalid: the same mutations inside the CRC, so that they reach the parser.
Bytes sealed(Mutator& mutator, uint32_t sequence) {
  Bytes payload = mutator.next();
  payload.resize(std::min(payload.size(), kMaxPayloadBytes));
  const auto type = static_cast<ruffini_MessageType>(mutator.byte() % 14);
  return host_frame(mutator.byte() < 200 ? ruffini_MessageType_MESSAGE_TYPE_COMMAND : type, payload, sequence);
}

size_t drain(Session& session) {
  size_t n = 0;
  for (auto out = session.pending(); !out.empty(); out = session.pending()) {
    n += out.size();
    if (n > kMaxBacklogBytes) fail("the session holds more than " + std::to_string(kMaxBacklogBytes) + " bytes");
    session.consumed(out.size());
  }
  return n;
}

void check_hello(Session& session) {
  drain(session);
  session.receive(Bytes{0});  // ends whatever a mutant began
  session.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_HELLO, {}, 1));
  FrameDecoder decoder;
  bool is_answered = false;
  for (auto out = session.pending(); !out.empty(); out = session.pending()) {
    for (const uint8_t byte : out) {
      const auto frame = decoder.push(byte);
      is_answered |= frame && frame->header.type == ruffini_MessageType_MESSAGE_TYPE_HELLO;
    }
    session.consumed(out.size());
  }
  if (!is_answered) fail("HELLO is not answered any more");
}

int run(const std::string& board_folder, const std::string& vectors, int n_mutants) {
  auto board = load_board(board_folder);
  if (!board) fail(board.error().message);
  auto path = FramePath::configure(board.value(), nullptr, [] { return uint64_t{0}; });
  if (!path) fail(path.error().message);
  const auto folder = std::filesystem::temp_directory_path() / "ruffini-fuzz-store";
  auto store = SlotStore::open(folder.string());
  if (!store) fail(store.error().message);
  Exchange exchange;
  Calibrator calibrator(board.value(), "0000", std::move(store).value(), exchange);
  Session session(board.value(), *path.value(), {.serial = "0000", .version = "fuzz"}, calibrator, exchange);

  std::vector<Bytes> seeds = host_messages();
  std::vector<Bytes> payloads;
  for (const Bytes& frame : seeds) {
    FrameDecoder decoder;
    for (const uint8_t byte : frame) {
      if (const auto whole = decoder.push(byte)) payloads.emplace_back(whole->payload.begin(), whole->payload.end());
    }
  }
  std::erase_if(payloads, [](const Bytes& b) { return b.empty(); });
  const std::vector<Bytes> golden = read_vectors(vectors);
  seeds.insert(seeds.end(), golden.begin(), golden.end());
  Mutator outside(std::move(seeds));
  Mutator inside(std::move(payloads));
  uint64_t now_us = 1;
  for (int i = 0; i < n_mutants; ++i) {
    session.receive(i % 2 == 0 ? outside.next() : sealed(inside, static_cast<uint32_t>(i)));
    if (i % 64 == 0) session.poll(now_us += 1'000);
    if (i % kCheckEvery == 0) check_hello(session);
  }
  Bytes noise(kNoiseBytes);
  std::generate(noise.begin(), noise.end(), [&] { return outside.byte(); });
  session.receive(noise);
  check_hello(session);
  std::filesystem::remove_all(folder);
  std::printf("%d mutated messages of %zu golden and own seeds, then %d bytes of noise: HELLO answered %d times\n",
              n_mutants, golden.size() + 12, kNoiseBytes, n_mutants / kCheckEvery + 1);
  return 0;
}

}  // namespace
}  // namespace ruffini

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) {
    std::fprintf(stderr, "usage: ruffini_fuzz_session BOARD_FOLDER VECTORS [N]\n");
    return 2;
  }
  return ruffini::run(argv[1], argv[2], argc > 3 ? std::atoi(argv[3]) : 1'000'000);
}
