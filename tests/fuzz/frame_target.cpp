// libFuzzer: any bytes from the line, and what decodes is encoded to the same bytes again.
#include <algorithm>
#include <cstdlib>

#include "link/frame_codec.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  ruffini::FrameDecoder decoder;
  for (size_t i = 0; i < size; ++i) {
    const auto frame = decoder.push(data[i]);
    if (!frame) continue;
    std::array<uint8_t, ruffini::kMaxFrameBytes> again;
    const size_t n = ruffini::encode_frame(frame->header, frame->payload, again);
    // COBS has one spelling of each content but for a redundant last 0x01 after 254 bytes, so decode again.
    ruffini::FrameDecoder second;
    for (size_t k = 0; k < n; ++k) {
      const auto same = second.push(again[k]);
      if (same && !std::equal(same->payload.begin(), same->payload.end(), frame->payload.begin(), frame->payload.end()))
        std::abort();
    }
  }
  return 0;
}
