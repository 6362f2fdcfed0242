#include "base/spsc_ring.h"

#include <gtest/gtest.h>

#include <numeric>
#include <thread>

namespace ruffini {
namespace {

TEST(SpscRing, FullMeansNothingIsStored) {
  SpscRing ring(16);
  const std::vector<uint8_t> message(12, 7);  // with its length exactly the capacity
  EXPECT_TRUE(ring.push(message));
  EXPECT_FALSE(ring.push({}));
  std::vector<uint8_t> out;
  EXPECT_TRUE(ring.pop(out));
  EXPECT_EQ(out, message);
  EXPECT_FALSE(ring.pop(out));
  EXPECT_FALSE(ring.push(std::vector<uint8_t>(13)));
  EXPECT_TRUE(ring.push({}));
  EXPECT_TRUE(ring.pop(out));
  EXPECT_TRUE(out.empty());
}

TEST(SpscRing, AMessageInTwoPartsIsTakenWithoutItsHead) {
  SpscRing ring(16);
  std::vector<uint8_t> out;
  for (uint8_t i = 0; i < 20; ++i) {  // so that every part comes to lie across the end
    const uint8_t head = i;
    const std::vector<uint8_t> body{1, i, 3};
    ASSERT_TRUE(ring.push({&head, 1}, body));
    uint8_t seen = 0xff;
    ASSERT_TRUE(ring.pop({&seen, 1}, [&] { return &out; }));
    EXPECT_EQ(seen, i);
    EXPECT_EQ(out, body);
  }
  EXPECT_FALSE(ring.push(std::vector<uint8_t>(3), std::vector<uint8_t>(10))) << "larger than the ring";
}

// One thread pushes messages of every length, the other takes them: all arrive, whole and in order.
TEST(SpscRing, TwoThreadsLoseNothing) {
  constexpr size_t kMessages = 20'000;
  SpscRing ring(512);
  std::thread producer([&] {
    for (size_t i = 0; i < kMessages; ++i) {
      std::vector<uint8_t> message(i % 200);
      std::iota(message.begin(), message.end(), static_cast<uint8_t>(i));
      while (!ring.push(message)) std::this_thread::yield();
    }
  });
  std::vector<uint8_t> got;
  for (size_t i = 0; i < kMessages; ++i) {
    while (!ring.pop(got)) std::this_thread::yield();
    std::vector<uint8_t> expected(i % 200);
    std::iota(expected.begin(), expected.end(), static_cast<uint8_t>(i));
    if (got != expected) {
      ADD_FAILURE() << "message " << i;
      break;
    }
  }
  producer.join();
}

}  // namespace
}  // namespace ruffini
