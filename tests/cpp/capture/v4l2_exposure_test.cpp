// What a camera on USB says of its exposure, beside what [exposure] asks. The device itself is
// tests/vm/usb_camera.py's.
#include "capture/v4l2_exposure.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>

namespace ruffini {
namespace {

constexpr ExposureSettings kAsked{.time_us = 5'000, .gain_1e3 = 2'000, .white_kelvin = 5'000};
constexpr V4l2Exposure kFirst{
    .mode = V4L2_EXPOSURE_MANUAL, .time_100us = 50, .gain = 40, .is_white_auto = 0, .white_kelvin = 5'000};

TEST(V4l2Exposure, WhatIsAsAskedIsNoDrift) {
  EXPECT_EQ(drift_of(kFirst, kFirst, kAsked), "");
  EXPECT_EQ(drift_of(V4l2Exposure{}, V4l2Exposure{}, kAsked), "") << "what is not told is not judged";
  V4l2Exposure stepped = kFirst;
  stepped.time_100us = 51;
  stepped.white_kelvin = 5'100;
  EXPECT_EQ(drift_of(stepped, kFirst, kAsked), "") << "a camera's steps: 100 us, 2 % of the white";
  ExposureSettings odd = kAsked;
  odd.time_us = 130;
  stepped.time_100us = 1;
  EXPECT_EQ(drift_of(stepped, kFirst, odd), "") << "130 us cannot be said in its unit";
}

TEST(V4l2Exposure, EachDriftIsNamedWithBothNumbers) {
  V4l2Exposure said = kFirst;
  said.mode = V4L2_EXPOSURE_APERTURE_PRIORITY;
  EXPECT_EQ(drift_of(said, kFirst, kAsked), "its automatic exposure on, asked off");
  said = kFirst;
  said.time_100us = 52;
  EXPECT_EQ(drift_of(said, kFirst, kAsked), "an exposure of 5200 us, asked 5000");
  said = kFirst;
  said.gain = 41;
  EXPECT_EQ(drift_of(said, kFirst, kAsked), "a gain of 41 in its own unit, 40 at the start");
  said = kFirst;
  said.is_white_auto = 1;
  EXPECT_EQ(drift_of(said, kFirst, kAsked), "its automatic white balance on, asked off");
  said = kFirst;
  said.white_kelvin = 4'890;
  EXPECT_EQ(drift_of(said, kFirst, kAsked), "a white of 4890 K, asked 5000");
}

TEST(V4l2Exposure, GainsAreCountedFromTheDefault) {
  EXPECT_EQ(device_gain(1'000, 10, 80, 20), 20);
  EXPECT_EQ(device_gain(4'000, 10, 80, 20), 80);
  EXPECT_EQ(device_gain(500, 10, 80, 20), 10);
  EXPECT_EQ(device_gain(1'025, 10, 80, 20), 21) << "half a step goes up";
  EXPECT_EQ(device_gain(4'100, 10, 80, 20), std::nullopt);
  EXPECT_EQ(device_gain(500, 0, 255, 128), 0) << "the minimum is a half where three times that would be below it";
  EXPECT_EQ(device_gain(1'496, 0, 255, 128), 255);
  EXPECT_EQ(device_gain(2'500, 0, 100, 0), 50);
  EXPECT_EQ(device_gain(1'000, 7, 7, 7), 7);
  EXPECT_EQ(device_gain(1'001, 7, 7, 7), std::nullopt);
}

TEST(V4l2Exposure, WhatIsNoCameraIsSaid) {
  const auto missing = V4l2Controls::open("A", "/dev/char/0:0", kAsked);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(missing.error().message.find("/dev/char/0:0 cannot be opened to set exposure.white_kelvin"),
            std::string::npos)
      << missing.error().message;
  const auto none = V4l2Controls::open("A", "/dev/null", kAsked);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kBadInput);
  EXPECT_NE(none.error().message.find("cannot be told exposure.white_kelvin"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
