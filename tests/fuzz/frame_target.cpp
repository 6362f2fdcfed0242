// libFuzzer: any bytes from the line; what is accepted is encoded and decoded to the same again.
#include <algorithm>
#include <cstdlib>

#include "link/frame_codec.h"

namespace {

void expect(bool holds) {
  if (!holds) std::abort();
}

void check_round_trip(const ruffini::WireFrame& frame) {
  const ruffini::FrameHeader& a = frame.header;
  expect(frame.payload.size() <= ruffini::kMaxPayloadBytes && a.fragment < a.n_fragments);
  std::array<uint8_t, ruffini::kMaxFrameBytes> bytes;
  const size_t n = ruffini::encode_frame(a, frame.payload, bytes);
  expect(n <= bytes.size() &&
         std::find(bytes.begin(), bytes.end(), 0) - bytes.begin() == static_cast<ptrdiff_t>(n) - 1);
  ruffini::FrameDecoder decoder;
  for (size_t i = 0; i + 1 < n; ++i) expect(!decoder.push(bytes[i]));
  const auto again = decoder.push(bytes[n - 1]);
  expect(again.has_value());
  const ruffini::FrameHeader& b = again->header;
  expect(a.flags == b.flags && a.type == b.type && a.sensor == b.sensor && a.sequence == b.sequence &&
         a.fragment == b.fragment && a.n_fragments == b.n_fragments &&
         std::equal(again->payload.begin(), again->payload.end(), frame.payload.begin(), frame.payload.end()));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  ruffini::FrameDecoder decoder;
  for (size_t i = 0; i < size; ++i) {
    if (const auto frame = decoder.push(data[i])) check_round_trip(*frame);
  }
  return 0;
}
