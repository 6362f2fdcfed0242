// libFuzzer: the real session, calibrator and calibration store on a medium in memory; the input is a list of what the
// host, the frame thread and the line do. What the device says must be whole frames, no more may wait than it promises,
// what is in force must be signed, and at the end HELLO must still be answered.
#include <pb_decode.h>
#include <pb_encode.h>

#include <memory>

#include "device.h"
#include "link/messages.h"
#include "link/session.h"
#include "support/crash_medium.h"
#include "support/fake_seams.h"

namespace ruffini {
namespace {

using fuzz::Bytes;
using fuzz::expect;
using fuzz::Input;

constexpr size_t kMaxBacklogBytes = 4'000'000;  // what the device may hold back for a host that does not read
constexpr size_t kMaxOps = 400;

const BoardSettings& board() {
  static const BoardSettings kBoard = fuzz::small_board();
  return kBoard;
}
const Bytes& table() {
  static const Bytes kTable = test::sign(test::diagonal_calibration(board()));
  return kTable;
}
uint64_t no_clock() { return 0; }

class Device {
 public:
  explicit Device(Exchange& exchange)
      : exchange_(exchange),
        path_(FramePath::configure(board(), nullptr, no_clock).value()),
        calibrator_(board(), "0000", SlotStore::open(std::make_unique<test::CrashMedium>()), exchange_,
                    {.n_good = 4, .n_frames = 16}),
        session_(board(), *path_, {.serial = "0000", .version = "fuzz"}, calibrator_, exchange_, {clock_, random_}) {
    std::string problem;
    expect(calibrator_.start(no_clock, problem).has_value() && problem.empty(), "an empty store starts");
  }
  ~Device() {
    session_.reset_line();  // empties the ring for the next run
    delete exchange_.next_path.exchange(nullptr);
    delete exchange_.retired_path.exchange(nullptr);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  void step(Input& in) {
    switch (in.u8() % 11) {
      case 0:  // anything on the line
        session_.receive(in.bytes(in.u8()));
        break;
      case 1: {  // a whole frame of anything
        const auto flags = static_cast<uint8_t>(in.u8() % 8 == 0 ? in.u8() : kFromHost);
        const FrameHeader header{flags, in.u8(), in.u8(), in.u8(), 0, static_cast<uint8_t>(in.u8() % 8 == 0 ? 2 : 1)};
        send(header, in.bytes(in.u8()));
        break;
      }
      case 2:  // any bytes as a command
        send({kFromHost, ruffini_MessageType_MESSAGE_TYPE_COMMAND, kDeviceSensor, 0, 0, 1}, in.bytes(in.u8()));
        break;
      case 3:
        command(some_command(in));
        break;
      case 4:
        upload(in);
        break;
      case 5:
        session_.poll(now_us_ += uint64_t{in.u16()} * 100);
        break;
      case 6:
        read(in.u16());
        break;
      case 7:
        take_over(in.u8());
        break;
      case 8:
        telemetry(in);
        break;
      case 9:  // the camera
        exchange_.is_camera_live = in.u8() % 2 == 0;
        exchange_.frames_captured += in.u8();
        break;
      default:  // the line was lost in the middle of a frame
        session_.reset_line();
        ear_ = FrameDecoder();
    }
    check_force();
  }

  void finish() {
    read_all();
    const uint64_t before = n_hellos_;
    session_.receive(Bytes{0});  // ends whatever was begun
    send({kFromHost, ruffini_MessageType_MESSAGE_TYPE_HELLO, kDeviceSensor, 0, 0, 1}, {});
    read_all();
    expect(n_hellos_ == before + 1, "HELLO is answered, once");
  }

 private:
  void send(const FrameHeader& header, const Bytes& payload) {
    std::array<uint8_t, kMaxFrameBytes> frame;
    session_.receive({frame.data(), encode_frame(header, payload, frame)});
  }

  void command(const ruffini_Command& m) {
    Bytes payload(ruffini_Command_size);
    pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
    expect(pb_encode(&stream, ruffini_Command_fields, &m), "a command can be encoded");
    payload.resize(stream.bytes_written);
    send({kFromHost, ruffini_MessageType_MESSAGE_TYPE_COMMAND, kDeviceSensor, 0, 0, 1}, payload);
  }

  static ruffini_Command some_command(Input& in) {
    constexpr std::array<pb_size_t, 10> kActions = {ruffini_Command_subscribe_tag,    ruffini_Command_zero_tag,
                                                    ruffini_Command_get_tag,          ruffini_Command_set_tag,
                                                    ruffini_Command_flash_begin_tag,  ruffini_Command_flash_chunk_tag,
                                                    ruffini_Command_flash_commit_tag, ruffini_Command_flash_abort_tag,
                                                    ruffini_Command_flash_undo_tag,   ruffini_Command_flash_query_tag};
    ruffini_Command m = ruffini_Command_init_zero;
    m.which_action = kActions[in.u8() % kActions.size()];
    m.request_id = in.u8();
    auto& action = m.action;
    switch (m.which_action) {
      case ruffini_Command_subscribe_tag:
        action.subscribe.subscriptions_count = in.u8() % 17;
        for (pb_size_t i = 0; i < action.subscribe.subscriptions_count; ++i) {
          action.subscribe.subscriptions[i] = {static_cast<ruffini_MessageType>(in.u8() % 16), in.u8()};
        }
        break;
      case ruffini_Command_zero_tag:
        action.zero.n_frames = in.u16();
        break;
      case ruffini_Command_flash_begin_tag:
        action.flash_begin.size_bytes = in.u8() % 2 == 0 ? in.u16() : uint64_t{in.u16()} << in.u8() % 48;
        action.flash_begin.sha256.size = 32;
        action.flash_begin.sha256.bytes[0] = in.u8();
        break;
      case ruffini_Command_flash_chunk_tag:
        action.flash_chunk.offset = in.u16();
        action.flash_chunk.data.size = in.u8();
        break;
      default:
        break;
    }
    return m;
  }

  // A calibration, whole or damaged before or after it was signed, in chunks as a host would send it.
  void upload(Input& in) {
    const uint8_t how = in.u8();
    Bytes file = how % 4 == 0 ? table() : in.spoilt(table());
    file.resize(std::max<size_t>(file.size(), crypto_sign_BYTES));
    if (how % 4 == 1) file = test::sign(std::move(file));
    ruffini_Command begin = ruffini_Command_init_zero;
    begin.which_action = ruffini_Command_flash_begin_tag;
    begin.request_id = ++request_id_;
    begin.action.flash_begin.size_bytes = file.size();
    const std::string hash = sha256(file);
    begin.action.flash_begin.sha256.size = static_cast<pb_size_t>(hash.size());
    std::copy(hash.begin(), hash.end(), begin.action.flash_begin.sha256.bytes);
    command(begin);
    ruffini_Command chunk = ruffini_Command_init_zero;
    chunk.which_action = ruffini_Command_flash_chunk_tag;
    const uint64_t resumed_at = calibrator_.next_offset();
    for (uint64_t at = resumed_at; at < file.size(); at += Calibrator::kMaxChunkBytes) {
      const size_t n = std::min<size_t>(Calibrator::kMaxChunkBytes, file.size() - at);
      chunk.request_id = ++request_id_;
      chunk.action.flash_chunk.offset = at;
      chunk.action.flash_chunk.data.size = static_cast<pb_size_t>(n);
      std::copy_n(file.begin() + static_cast<ptrdiff_t>(at), n, chunk.action.flash_chunk.data.bytes);
      command(chunk);
    }
    ruffini_Command commit = ruffini_Command_init_zero;
    commit.which_action = ruffini_Command_flash_commit_tag;
    commit.request_id = ++request_id_;
    command(commit);
    // A file that was refused during a trial waits, and a later commit is of it.
    if (fuzz::is_signed(file)) signed_.push_back(hash);
    read_all();  // 64 replies may wait, and no more
  }

  // As the frame thread: a path that waits is taken over, frames are counted for its trial.
  void take_over(uint8_t n) {
    if (FramePath* next = exchange_.next_path.exchange(nullptr)) {
      delete exchange_.retired_path.exchange(path_.release());
      path_.reset(next);
    }
    exchange_.tally = {path_->calibration_id(), static_cast<uint16_t>(n % 32), static_cast<uint16_t>(n / 32)};
    exchange_.frames_processed += n;
  }

  void telemetry(Input& in) {
    const auto type = static_cast<ruffini_MessageType>(4 + in.u8() % 6);
    const Bytes content = in.bytes(in.u8());
    Bytes frames(frames_bound(content.size()));
    frames.resize(write_frames(type, 0, 0, n_sent_++, content, frames));
    (void)exchange_.push_telemetry({n_sent_, static_cast<uint64_t>(type)}, frames);
  }

  void read(size_t n_bytes) {
    for (auto out = session_.pending(); !out.empty() && n_bytes > 0; out = session_.pending()) {
      const size_t n = std::min(n_bytes, out.size());
      for (const uint8_t byte : out.first(n)) hear(byte);
      session_.consumed(n);
      n_bytes -= n;
    }
  }
  void read_all() {
    session_.poll(now_us_ += 1'000);
    size_t n = 0;
    for (auto out = session_.pending(); !out.empty(); out = session_.pending()) {
      expect((n += out.size()) <= kMaxBacklogBytes, "what waits is bounded");
      read(out.size());
    }
  }
  void hear(uint8_t byte) {
    const auto frame = ear_.push(byte);
    const DecoderCounters& bad = ear_.counters();
    expect(bad.bad_crc + bad.malformed + bad.oversize == 0, "what the device says is frames");
    if (frame && frame->header.type == ruffini_MessageType_MESSAGE_TYPE_HELLO) ++n_hellos_;
  }

  // In force is nothing, or a signed file that was sent in this run.
  void check_force() const {
    const ActiveCalibration& active = calibrator_.active();
    if (!active.is_present) return;
    expect(std::find(signed_.begin(), signed_.end(), active.sha256) != signed_.end(),
           "in force is what was sent, and signed");
    expect(calibrator_.next_offset() <= Calibrator::kMaxUploadBytes, "an upload is bounded");
  }

  Exchange& exchange_;
  std::unique_ptr<FramePath> path_;
  Calibrator calibrator_;
  test::FakeClock clock_;
  test::FakeRandom random_;
  Session session_;
  FrameDecoder ear_;
  uint64_t now_us_ = 0;
  uint32_t request_id_ = 0x8000'0000;
  uint32_t n_sent_ = 0;
  uint64_t n_hellos_ = 0;
  std::vector<std::string> signed_;  // SHA-256 of the files that were sent
};

}  // namespace
}  // namespace ruffini

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static ruffini::Exchange exchange;  // its ring of 4 MiB is made once
  exchange.tally = ruffini::PathTally{};
  ruffini::fuzz::Input in(data, size);
  ruffini::Device device(exchange);
  for (size_t n = 0; n < ruffini::kMaxOps && !in.is_empty(); ++n) device.step(in);
  device.finish();
  return 0;
}
