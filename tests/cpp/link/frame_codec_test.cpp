#include "link/frame_codec.h"

#include <gtest/gtest.h>

#include "support/vectors.h"

namespace ruffini {
namespace {

std::string text_of(const WireFrame& f) {
  return "frame type=" + std::to_string(f.header.type) + " flags=" + std::to_string(f.header.flags) +
         " sensor=" + std::to_string(f.header.sensor) + " sequence=" + std::to_string(f.header.sequence) +
         " fragment=" + std::to_string(f.header.fragment) + " fragments=" + std::to_string(f.header.n_fragments) +
         " payload=" + test::to_hex({f.payload.begin(), f.payload.end()});
}

// What the decoder says of these bytes, in order, as the vectors write it.
std::string outcome_of(const std::vector<uint8_t>& bytes) {
  FrameDecoder decoder;
  DecoderCounters before;
  std::string out;
  const auto say = [&](const std::string& what) { out += (out.empty() ? "" : "; ") + what; };
  for (const uint8_t byte : bytes) {
    if (const auto frame = decoder.push(byte)) say(text_of(*frame));
    const DecoderCounters& now = decoder.counters();
    if (now.bad_crc != before.bad_crc) say("bad_crc");
    if (now.malformed != before.malformed) say("malformed");
    if (now.oversize != before.oversize) say("oversize");
    before = now;
  }
  return out;
}

TEST(FrameCodec, SaysOfTheGoldenBytesWhatTheSpecificationSays) {
  const auto vectors = test::read_vectors(RUFFINI_VECTORS_DIR "/frames.txt");
  ASSERT_GE(vectors.size(), 50U);
  for (const auto& v : vectors) {
    ASSERT_EQ(v.size(), 3U);
    EXPECT_EQ(outcome_of(test::from_hex(v[1])), v[2]) << v[0];
  }
}

TEST(FrameCodec, EncodesTheGoldenFramesByteForByte) {
  int n = 0;
  for (const auto& v : test::read_vectors(RUFFINI_VECTORS_DIR "/frames.txt")) {
    const std::vector<uint8_t> bytes = test::from_hex(v[1]);
    if (v[2].rfind("frame", 0) != 0 || v[2].find(';') != std::string::npos) continue;
    FrameDecoder decoder;
    for (const uint8_t byte : bytes) {
      const auto frame = decoder.push(byte);
      if (!frame) continue;
      std::array<uint8_t, kMaxFrameBytes> again;
      const size_t n_again = encode_frame(frame->header, frame->payload, again);
      EXPECT_EQ(test::to_hex({again.begin(), again.begin() + static_cast<ptrdiff_t>(n_again)}), v[1]) << v[0];
      ++n;
    }
  }
  EXPECT_GE(n, 15);
}

TEST(FrameCodec, TheLargestPayloadFitsTheLargestFrame) {
  const std::vector<uint8_t> payload(kMaxPayloadBytes, 0x55);
  std::array<uint8_t, kMaxFrameBytes> out;
  EXPECT_LE(encode_frame({}, payload, out), kMaxFrameBytes);
}

}  // namespace
}  // namespace ruffini
