// A session on a board of its own with a store in a folder, and the host's end of its line.
#pragma once

#include <gtest/gtest.h>
#include <pb_decode.h>
#include <pb_encode.h>
#include <unistd.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "board/parse.h"
#include "link/messages.h"
#include "link/session.h"
#include "support/fake_seams.h"

namespace ruffini::test {

using Bytes = std::vector<uint8_t>;

inline Bytes host_frame(ruffini_MessageType type, const Bytes& payload = {}, uint8_t sensor = kDeviceSensor) {
  Bytes out(frames_bound(payload.size()));
  out.resize(write_frames(type, kFromHost, sensor, 0, payload, out));
  return out;
}

inline BoardSettings board_with_thermometer() {
  BoardSettings board = load_board(std::string(RUFFINI_BOARDS_DIR) + "/gelslim").value();
  board.temperature.place = "gel";
  return board;
}

class SessionTest : public testing::Test {
 protected:
  SessionTest()
      : board_(board_with_thermometer()),
        path_(FramePath::configure(board_, nullptr, [] { return uint64_t{0}; }).value()),
        folder_(testing::TempDir() + "session_test_store" + std::to_string(::getpid())),
        calibrator_(board_, "0042", SlotStore::open(folder_).value(), exchange_),
        session_(board_, *path_, {.serial = "0042", .version = "test", .stream_flags = kSimulated}, calibrator_,
                 exchange_, {clock_, random_}) {}
  ~SessionTest() override { std::filesystem::remove_all(folder_); }

  // Everything that the session wants to write, as messages (fragments joined).
  struct Message {
    FrameHeader header;
    Bytes payload;
  };
  std::vector<Message> read_all() {
    std::vector<Message> out;
    for (auto bytes = session_.pending(); !bytes.empty(); bytes = session_.pending()) {
      for (const uint8_t byte : bytes) {
        const auto frame = decoder_.push(byte);
        if (!frame) continue;
        if (frame->header.fragment == 0) out.push_back({frame->header, {}});
        out.back().payload.insert(out.back().payload.end(), frame->payload.begin(), frame->payload.end());
      }
      session_.consumed(bytes.size());
    }
    return out;
  }
  std::vector<Message> ask(ruffini_MessageType type, const Bytes& payload = {}, uint8_t sensor = kDeviceSensor) {
    session_.receive(host_frame(type, payload, sensor));
    return read_all();
  }
  ruffini_Status status(uint64_t now_us = 5) {
    session_.receive(host_frame(ruffini_MessageType_MESSAGE_TYPE_STATUS));
    session_.poll(now_us);
    const auto answers = read_all();
    EXPECT_EQ(answers.size(), 1U);
    ruffini_Status status = ruffini_Status_init_zero;
    pb_istream_t in = pb_istream_from_buffer(answers.at(0).payload.data(), answers.at(0).payload.size());
    EXPECT_TRUE(pb_decode(&in, ruffini_Status_fields, &status));
    return status;
  }
  static Bytes encoded(const ruffini_Command& request) {
    Bytes payload(ruffini_Command_size);
    pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
    EXPECT_TRUE(pb_encode(&stream, ruffini_Command_fields, &request));
    payload.resize(stream.bytes_written);
    return payload;
  }
  // The one message that a session wants to write; false: none, or another kind.
  bool take(Session& session, const pb_msgdesc_t* fields, void* message) {
    Bytes payload;
    for (auto bytes = session.pending(); !bytes.empty(); bytes = session.pending()) {
      for (const uint8_t byte : bytes) {
        if (const auto frame = decoder_.push(byte)) {
          payload.insert(payload.end(), frame->payload.begin(), frame->payload.end());
        }
      }
      session.consumed(bytes.size());
    }
    pb_istream_t in = pb_istream_from_buffer(payload.data(), payload.size());
    return !payload.empty() && pb_decode(&in, fields, message);
  }
  ruffini_Reply command(const ruffini_Command& request, uint8_t sensor = kDeviceSensor) {
    const auto answers = ask(ruffini_MessageType_MESSAGE_TYPE_COMMAND, encoded(request), sensor);
    ruffini_Reply reply = ruffini_Reply_init_zero;
    EXPECT_EQ(answers.size(), 1U);
    if (answers.empty()) return reply;
    EXPECT_EQ(answers[0].header.type, ruffini_MessageType_MESSAGE_TYPE_REPLY);
    pb_istream_t in = pb_istream_from_buffer(answers[0].payload.data(), answers[0].payload.size());
    EXPECT_TRUE(pb_decode(&in, ruffini_Reply_fields, &reply));
    EXPECT_EQ(reply.request_id, request.request_id);
    return reply;
  }
  static ruffini_Command request(uint32_t id, pb_size_t action) {
    ruffini_Command m = ruffini_Command_init_zero;
    m.request_id = id;
    m.which_action = action;
    return m;
  }
  void push_telemetry(ruffini_MessageType type, const Bytes& content, uint64_t exposed_us = 0) {
    ASSERT_TRUE(exchange_.push_telemetry({exposed_us, static_cast<uint64_t>(type)}, content));
  }

  BoardSettings board_;
  std::unique_ptr<FramePath> path_;
  std::string folder_;
  Exchange exchange_;
  FakeClock clock_;
  FakeRandom random_;
  Calibrator calibrator_;
  Session session_;
  FrameDecoder decoder_;
};

}  // namespace ruffini::test
