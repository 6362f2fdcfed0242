// libFuzzer: any bytes as any message of the wire, as nanopb decodes them: what is accepted is encoded to bytes that
// are accepted and say the same again.
#include <pb_decode.h>
#include <pb_encode.h>

#include <algorithm>
#include <array>
#include <functional>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "device.h"
#include "ruffini.pb.h"

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
  ruffini_SignedCommand signed_command;
  ruffini_Time time;
};

constexpr std::array kMessages = {ruffini_Command_fields, ruffini_Hello_fields,    ruffini_Status_fields,
                                  ruffini_Wrench_fields,  ruffini_Contacts_fields, ruffini_Event_fields,
                                  ruffini_Reply_fields,   ruffini_Learned_fields,  ruffini_SignedCommand_fields,
                                  ruffini_Time_fields};

// Debian's nanopb is not instrumented: what it says is told to libFuzzer as coverage of our own.
constexpr size_t kCounters = 4'096;
__attribute__((section("__libfuzzer_extra_counters"))) uint8_t counters[kCounters];

void tell(size_t kind, std::string_view what) {
  counters[(kind * 7'919 + std::hash<std::string_view>()(what)) % kCounters] = 1;
}

bool decode(const pb_msgdesc_t* fields, const std::vector<uint8_t>& bytes, AnyMessage& out) {
  pb_istream_t stream = pb_istream_from_buffer(bytes.data(), bytes.size());
  const bool done = pb_decode(&stream, fields, &out);
  const size_t left = std::min<size_t>(stream.bytes_left, 8);  // how far it came
  tell(static_cast<size_t>(fields->largest_tag) * 16 + left, done ? "" : PB_GET_ERROR(&stream));
  return done;
}

// Which fields are there, two levels deep.
void tell_fields(size_t kind, std::span<const uint8_t> bytes, int depth) {
  pb_istream_t stream = pb_istream_from_buffer(bytes.data(), bytes.size());
  pb_wire_type_t wire_type{};
  uint32_t tag = 0;
  bool is_end = false;
  while (pb_decode_tag(&stream, &wire_type, &tag, &is_end)) {
    const uint8_t* at = bytes.data() + (bytes.size() - stream.bytes_left);
    if (!pb_skip_field(&stream, wire_type)) return;
    const auto n = static_cast<size_t>(bytes.data() + (bytes.size() - stream.bytes_left) - at);
    const size_t here = kind * 131 + tag;
    tell(here, n > 64 ? "large" : n > 2 ? "middle" : "small");
    if (wire_type == PB_WT_STRING && depth > 0 && n > 0) tell_fields(here, {at + 1, n - 1}, depth - 1);
  }
}

std::vector<uint8_t> encode(const pb_msgdesc_t* fields, const AnyMessage& message) {
  size_t n = 0;
  ruffini::fuzz::expect(pb_get_encoded_size(&n, fields, &message), "what was decoded can be encoded");
  std::vector<uint8_t> out(n);
  pb_ostream_t stream = pb_ostream_from_buffer(out.data(), out.size());
  ruffini::fuzz::expect(pb_encode(&stream, fields, &message) && stream.bytes_written == n, "its size is right");
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  const pb_msgdesc_t* fields = kMessages[data[0] % kMessages.size()];
  static const auto kFirst = std::make_unique<AnyMessage>();
  static const auto kAgain = std::make_unique<AnyMessage>();
  if (!decode(fields, {data + 1, data + size}, *kFirst)) return 0;
  const std::vector<uint8_t> bytes = encode(fields, *kFirst);
  tell_fields(data[0] % kMessages.size(), bytes, 1);
  ruffini::fuzz::expect(decode(fields, bytes, *kAgain), "what was encoded is decoded");
  ruffini::fuzz::expect(encode(fields, *kAgain) == bytes, "it says the same again");
  return 0;
}
