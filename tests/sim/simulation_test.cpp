// The harness itself: one seed is one story, every fault comes, and its codec is the one on paper.
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

#include "reference_codec.h"
#include "world.h"

namespace ruffini::sim {
namespace {

constexpr uint64_t kMinuteUs = 60'000'000;

const TinySensor& sensor() {
  static const TinySensor kSensor;
  return kSensor;
}

TEST(Simulation, TheSameSeedGivesTheSameEventsByteForByte) {
  const Outcome first = simulate(sensor(), 5, kMinuteUs, true);
  const Outcome other = simulate(sensor(), 6, kMinuteUs, true);
  const Outcome again = simulate(sensor(), 5, kMinuteUs, true);
  EXPECT_EQ(first.broken, "");
  EXPECT_GT(std::count(first.text.begin(), first.text.end(), '\n'), 1'000);
  EXPECT_EQ(first.text, again.text);
  EXPECT_EQ(first.hash, again.hash);
  EXPECT_NE(first.hash, other.hash);
  EXPECT_EQ(simulate(sensor(), 5, kMinuteUs, false).hash, first.hash) << "with or without text";
}

// Its steps run in one thread, segment by segment.
TEST(Simulation, TwoCoresGiveTheEventsOfOne) {
  TinySensor two = sensor();
  two.board.n_cores = 2;
  EXPECT_EQ(simulate(two, 5, kMinuteUs, true).text, simulate(sensor(), 5, kMinuteUs, true).text);
}

// A fault that never comes proves nothing.
TEST(Simulation, EveryFaultComesAndTheDeviceStillWorks) {
  constexpr uint64_t kSeeds = 40;
  Outcome sum;
  for (uint64_t seed = 1'000; seed < 1'000 + kSeeds; ++seed) {
    const Outcome one = simulate(sensor(), seed, kMinuteUs, false);
    EXPECT_EQ(one.broken, "") << "again: ruffini_simulation --chaos-s 60 --log events.txt --seed " << seed;
    for (size_t i = 0; i < kFaults; ++i) sum.faults[i] += one.faults[i];
    sum.n_valid_forces += one.n_valid_forces;
    sum.n_stale += one.n_stale;
    sum.n_confirmed += one.n_confirmed;
    sum.n_reverted += one.n_reverted;
  }
  for (size_t i = 0; i < kFaults; ++i) EXPECT_GT(sum.faults[i], 0U) << kFaultNames[i];
  EXPECT_GT(sum.n_valid_forces, 1'000 * kSeeds);
  EXPECT_GT(sum.n_stale, kSeeds);
  EXPECT_GT(sum.n_confirmed, kSeeds);
  EXPECT_GT(sum.n_reverted, kSeeds / 8);
}

// proto/README.md, the example.
TEST(ReferenceCodec, WritesTheExampleOfTheSpecification) {
  const std::vector<uint8_t> hello = {5, 1, 1, 1, 255, 1, 1, 1, 1, 2, 1, 1, 5, 0xFD, 0xCB, 0xD2, 0x74, 0};
  EXPECT_EQ(reference_frame(1, {}, 0), hello);
}

TEST(ReferenceCodec, ReadsWhatItWritesAndNoDamagedFrame) {
  for (const size_t n : {0U, 1U, 253U, 254U, 255U, 600U, 4'000U}) {
    std::vector<uint8_t> payload(n);
    std::iota(payload.begin(), payload.end(), uint8_t{0});
    std::vector<uint8_t> frame = reference_frame(11, payload, 70'000);
    for (const bool is_damaged : {false, true}) {
      if (is_damaged) frame[frame.size() / 2] ^= 4;
      ReferenceDecoder decoder;
      std::optional<ReferenceFrame> read;
      for (const uint8_t byte : frame) {
        if (auto one = decoder.push(byte, 7)) read = std::move(one);
      }
      EXPECT_EQ(read.has_value(), !is_damaged) << n;
      EXPECT_EQ(decoder.n_damaged() > 0, is_damaged);
      if (!read) continue;
      EXPECT_EQ(read->payload, payload);
      EXPECT_EQ(read->sequence, 70'000U);
      EXPECT_EQ(read->type, 11);
      EXPECT_EQ(read->begun_us, 7U);
    }
  }
}

}  // namespace
}  // namespace ruffini::sim
