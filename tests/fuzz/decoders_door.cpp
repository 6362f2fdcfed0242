// The firmware's decoders behind a C interface, many inputs a call: tests/fuzz/differential.py holds the host's to them.
#include <pb_decode.h>
#include <pb_encode.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "link/frame_codec.h"
#include "ruffini.pb.h"
#include "support/dense_decoder.h"

namespace {

union AnyMessage {
  ruffini_Hello hello;
  ruffini_Status status;
  ruffini_Wrench wrench;
  ruffini_Contacts contacts;
  ruffini_Event event;
  ruffini_Command command;
  ruffini_Reply reply;
  ruffini_Learned learned;
};

const pb_msgdesc_t* fields_of(int type) {
  switch (type) {
    case ruffini_MessageType_MESSAGE_TYPE_HELLO:
      return ruffini_Hello_fields;
    case ruffini_MessageType_MESSAGE_TYPE_STATUS:
      return ruffini_Status_fields;
    case ruffini_MessageType_MESSAGE_TYPE_WRENCH:
      return ruffini_Wrench_fields;
    case ruffini_MessageType_MESSAGE_TYPE_CONTACTS:
      return ruffini_Contacts_fields;
    case ruffini_MessageType_MESSAGE_TYPE_EVENT:
      return ruffini_Event_fields;
    case ruffini_MessageType_MESSAGE_TYPE_COMMAND:
      return ruffini_Command_fields;
    case ruffini_MessageType_MESSAGE_TYPE_REPLY:
      return ruffini_Reply_fields;
    case ruffini_MessageType_MESSAGE_TYPE_LEARNED:
      return ruffini_Learned_fields;
    default:
      return nullptr;
  }
}

}  // namespace

extern "C" {

// What the decoder says of `n` bytes from the line, into `out`: of each frame of the direction that is listened to
// its header (type, sensor, flags, fragment, fragments, u32 sequence, u16 length) and payload; then u16 bad_crc, malformed,
// oversize and frames of the other direction. Returns the number of bytes, -1: `capacity` is too small.
int64_t ruffini_judge_line(const uint8_t* bytes, int64_t n, int from_host, uint8_t* out, int64_t capacity) {
  ruffini::FrameDecoder decoder;
  std::vector<uint8_t> said;
  const auto put = [&](uint64_t value, int n_bytes) {
    for (int i = 0; i < n_bytes; ++i) said.push_back(static_cast<uint8_t>(value >> (8 * i)));
  };
  uint16_t n_other = 0;
  for (int64_t i = 0; i < n; ++i) {
    const auto frame = decoder.push(bytes[i]);
    if (!frame) continue;
    const ruffini::FrameHeader& h = frame->header;
    if (((h.flags & ruffini::kFromHost) != 0) != (from_host != 0)) {
      ++n_other;
      continue;
    }
    for (const uint8_t byte : {h.type, h.sensor, h.flags, h.fragment, h.n_fragments}) said.push_back(byte);
    put(h.sequence, 4);
    put(frame->payload.size(), 2);
    said.insert(said.end(), frame->payload.begin(), frame->payload.end());
  }
  const ruffini::DecoderCounters& counters = decoder.counters();
  for (const uint64_t counter : {counters.bad_crc, counters.malformed, counters.oversize, uint64_t{n_other}}) {
    put(counter, 2);
  }
  if (static_cast<int64_t>(said.size()) > capacity) return -1;
  std::memcpy(out, said.data(), said.size());
  return static_cast<int64_t>(said.size());
}

// A payload decoded and encoded again into `out`. Returns the number of bytes, -1: refused, and `why` (64 bytes) says why.
int64_t ruffini_judge_message(int type, const uint8_t* bytes, int64_t n, uint8_t* out, int64_t capacity, char* why) {
  static const auto kMessage = std::make_unique<AnyMessage>();
  const pb_msgdesc_t* fields = fields_of(type);
  pb_istream_t in = pb_istream_from_buffer(bytes, static_cast<size_t>(n));
  if (!pb_decode(&in, fields, kMessage.get())) {
    std::strncpy(why, PB_GET_ERROR(&in), 63);
    return -1;
  }
  pb_ostream_t stream = pb_ostream_from_buffer(out, static_cast<size_t>(capacity));
  if (!pb_encode(&stream, fields, kMessage.get())) {
    std::strncpy(why, "cannot be encoded again", 63);
    return -1;
  }
  return static_cast<int64_t>(stream.bytes_written);
}

// Node values into `values`; false where they are refused.
int ruffini_judge_dense(int is_sparse, int64_t n_nodes, int64_t n_components, const uint8_t* bytes, int64_t n,
                        int32_t* values) {
  const auto out = ruffini::test::decode_dense(is_sparse != 0, static_cast<size_t>(n_nodes),
                                               static_cast<size_t>(n_components), {bytes, static_cast<size_t>(n)});
  if (!out) return 0;
  if (!out->empty()) std::memcpy(values, out->data(), out->size() * sizeof(int32_t));
  return 1;
}
}
