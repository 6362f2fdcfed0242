#include "capture/stream_limits.h"

#include <gtest/gtest.h>

namespace ruffini {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::seconds;

TEST(Silence, OfAFastCameraIsASecondOfASlowOneThreePeriods) {
  EXPECT_EQ(longest_silence(milliseconds{10}, 0), seconds{1});
  EXPECT_EQ(longest_silence(microseconds{333'333}, 0), seconds{1});
  EXPECT_EQ(longest_silence(seconds{2}, 0), seconds{6});
}

TEST(Silence, DoublesWithEachStartThatGaveNoFrame) {
  EXPECT_EQ(longest_silence(milliseconds{20}, 1), seconds{2});
  EXPECT_EQ(longest_silence(milliseconds{20}, 3), seconds{8});
  EXPECT_EQ(longest_silence(seconds{2}, 2), seconds{24});
}

}  // namespace
}  // namespace ruffini
