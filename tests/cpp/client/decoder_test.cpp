// The C++ consumer's frames against the golden bytes, and against the firmware's own decoder.
#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "link/frame_codec.h"
#include "ruffini/client.h"
#include "support/vectors.h"

namespace ruffini::client {
namespace {

std::string text_of(const Packet& p) {
  const int flags = (p.is_simulated ? 2 : 0) + (p.is_replay ? 4 : 0);
  return "frame type=" + std::to_string(static_cast<int>(p.type)) + " flags=" + std::to_string(flags) +
         " sensor=" + std::to_string(p.sensor) + " sequence=" + std::to_string(p.sequence) +
         " fragment=0 fragments=1 payload=" + ruffini::test::to_hex(p.payload);
}

std::vector<std::string> events_of(const std::string& outcome) {
  std::vector<std::string> out;
  for (size_t at = 0; at != std::string::npos;) {
    const size_t end = outcome.find("; ", at);
    out.push_back(outcome.substr(at, end == std::string::npos ? end : end - at));
    at = end == std::string::npos ? end : end + 2;
  }
  return out;
}

TEST(ClientDecoder, SaysOfTheGoldenBytesWhatTheSpecificationSays) {
  int n = 0;
  for (const auto& v : ruffini::test::read_vectors(RUFFINI_VECTORS_DIR "/frames.txt")) {
    const std::vector<uint8_t> bytes = ruffini::test::from_hex(v[1]);
    Decoder decoder;
    std::vector<std::string> said;
    for (const Packet& p : decoder.feed(bytes.data(), bytes.size())) said.push_back(text_of(p));
    std::vector<std::string> want;
    uint64_t n_host = 0;
    const auto events = events_of(v[2]);
    for (const std::string& e : events) {
      if (e.rfind("frame", 0) != 0) continue;
      if (e.find("flags=1 ") != std::string::npos) {
        ++n_host;
      } else if (e.find("fragments=1 ") != std::string::npos) {  // a fragment of several is no message yet
        want.push_back(e);
      }
    }
    EXPECT_EQ(said, want) << v[0];
    const Counters& c = decoder.counters();
    const auto count = [&](const char* what) {
      return static_cast<uint64_t>(std::count(events.begin(), events.end(), what));
    };
    EXPECT_EQ(c.bad_crc, count("bad_crc")) << v[0];
    EXPECT_EQ(c.malformed, count("malformed")) << v[0];
    EXPECT_EQ(c.oversize, count("oversize")) << v[0];
    EXPECT_EQ(c.echo, n_host) << v[0];
    ++n;
  }
  EXPECT_GE(n, 40);
}

std::vector<uint8_t> device_frame(uint8_t type, uint32_t sequence, uint8_t fragment, uint8_t n_fragments,
                                  const std::vector<uint8_t>& payload) {
  std::array<uint8_t, kMaxFrameBytes> out;
  const size_t n = encode_frame({0, type, 2, sequence, fragment, n_fragments}, payload, out);
  return {out.begin(), out.begin() + static_cast<ptrdiff_t>(n)};
}

std::vector<Packet> feed(Decoder& decoder, const std::vector<uint8_t>& bytes) {
  return decoder.feed(bytes.data(), bytes.size());
}

TEST(ClientDecoder, PutsALongMessageTogetherByteByByte) {
  Decoder decoder;
  std::vector<Packet> got;
  for (uint8_t i = 0; i < 3; ++i) {
    for (const uint8_t byte : device_frame(9, 7, i, 3, std::vector<uint8_t>(i < 2 ? 4'048 : 5, i))) {
      for (auto& p : feed(decoder, {byte})) got.push_back(std::move(p));
    }
  }
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0].payload.size(), 2U * 4'048 + 5);
  EXPECT_EQ(got[0].payload.back(), 2);
  EXPECT_EQ(got[0].sensor, 2);
}

TEST(ClientDecoder, ALostFragmentLosesItsMessageAlone) {
  Decoder decoder;
  EXPECT_TRUE(feed(decoder, device_frame(9, 0, 0, 3, {1})).empty());
  EXPECT_TRUE(feed(decoder, device_frame(9, 0, 2, 3, {1})).empty());
  EXPECT_EQ(feed(decoder, device_frame(9, 1, 0, 1, {})).size(), 1U);
  EXPECT_EQ(decoder.counters().incomplete, 1U);
  // Fragments that differ in their header are not of one message.
  EXPECT_TRUE(feed(decoder, device_frame(9, 2, 0, 2, {1})).empty());
  EXPECT_TRUE(feed(decoder, device_frame(8, 2, 1, 2, {1})).empty());
  EXPECT_EQ(decoder.counters().incomplete, 2U);
}

TEST(ClientDecoder, CountsWhatNeverCameAndTakesARestartForNone) {
  Decoder decoder;
  for (const uint32_t sequence : {0xFFFF'FFFDU, 0U, 1U, 5U, 0U}) feed(decoder, device_frame(9, sequence, 0, 1, {}));
  EXPECT_EQ(decoder.counters().lost, 2U + 3U);
}

TEST(ClientDecoder, FindsItsFeetAfterNoise) {
  std::mt19937 random(1);
  Decoder decoder;
  for (int i = 0; i < 2'000; ++i) {
    std::vector<uint8_t> noise(random() % 300);
    for (uint8_t& byte : noise) byte = static_cast<uint8_t>(random());
    noise.push_back(0);
    const auto among = feed(decoder, noise);
    ASSERT_TRUE(among.empty());
    ASSERT_EQ(feed(decoder, device_frame(9, 0, 0, 1, noise)).size(), 1U);
  }
}

TEST(ClientDamageWatch, OneDamagedFrameInSixMinutesIsTolerated) {
  DamageWatch watch;
  for (uint64_t i = 0; i < 5; ++i) EXPECT_FALSE(watch.update(i + 1, 360.0 * static_cast<double>(i)));
}

TEST(ClientDamageWatch, ASecondOneMakesTheLineUnfitForSixMinutes) {
  DamageWatch watch;
  EXPECT_FALSE(watch.update(1, 100.0));
  watch.begin_decoder();
  EXPECT_FALSE(watch.is_unfit(300.0));
  EXPECT_TRUE(watch.update(1, 459.0));
  EXPECT_FALSE(watch.update(2, 459.5)) << "reported already";
  EXPECT_TRUE(watch.is_unfit(818.0));
  EXPECT_FALSE(watch.is_unfit(820.0));
}

TEST(ClientDamageWatch, TwoAtOnceAreEnough) { EXPECT_TRUE(DamageWatch().update(2, 0.0)); }

// The firmware's decoder, which knows nothing of this encoder, hears what the golden bytes say.
TEST(ClientEncoder, SaysWhatTheGoldenBytesSay) {
  Encoder encoder(0);
  const Bytes hello = encoder.ask_hello();
  EXPECT_EQ(ruffini::test::to_hex(hello), "0005010101ff0101010102010105fdcbd27400");
  EXPECT_EQ(ruffini::test::to_hex(encoder.ask_status()), "06010103ff01010101020101056137aeae00");
  const auto payload_of = [](const Bytes& bytes) {
    FrameDecoder decoder;
    for (size_t i = 0; i + 1 < bytes.size(); ++i) EXPECT_FALSE(decoder.push(bytes[i]));
    const auto frame = decoder.push(bytes.back());
    EXPECT_TRUE(frame && frame->header.flags == kFromHost && frame->header.type == 11 && frame->header.sensor == 255);
    return frame ? ruffini::test::to_hex({frame->payload.begin(), frame->payload.end()}) : "";
  };
  for (int i = 0; i < 6; ++i) (void)encoder.zero();
  EXPECT_EQ(payload_of(encoder.subscribe({{Type::kWrench, 1}, {Type::kField, 4}})), "0807120c0a04080410010a0408051004");
  EXPECT_EQ(encoder.request_id(), 7U);
  EXPECT_EQ(payload_of(encoder.zero()), "08081a00");
  // holder 300, n_frames 20, even_if_touched
  Encoder held(300);
  EXPECT_EQ(payload_of(held.zero(20, true)), "08011a0408141001e003ac02");
}

}  // namespace
}  // namespace ruffini::client
