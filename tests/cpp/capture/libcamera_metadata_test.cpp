// What libcamera's metadata say of a frame: when, and whether it was taken as [exposure] asks.
#include "capture/libcamera_metadata.h"

#include <gtest/gtest.h>

#include <array>
#include <ctime>

namespace ruffini {
namespace {

namespace lc = libcamera;

int64_t now_ns(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

ExposureSettings asked() { return {.time_us = 5'000, .gain_1e3 = 2'000, .red_1e3 = 1'500, .blue_1e3 = 1'200}; }

lc::ControlList said(int32_t time_us, float gain, float red, float blue) {
  lc::ControlList out(lc::controls::controls);
  out.set(lc::controls::ExposureTime, time_us);
  out.set(lc::controls::AnalogueGain, gain);
  const std::array<float, 2> colours = {red, blue};
  out.set(lc::controls::ColourGains, lc::Span<const float, 2>(colours));
  return out;
}

TEST(LibcameraMetadata, ASensorsStepsAreNoDrift) {
  EXPECT_EQ(drift_of(said(5'000, 2.0F, 1.5F, 1.2F), asked()), "");
  EXPECT_EQ(drift_of(said(4'910, 1.93F, 1.525F, 1.18F), asked()), "");
  EXPECT_EQ(drift_of(lc::ControlList(lc::controls::controls), asked()), "") << "what is not told is not judged";
  EXPECT_EQ(drift_of(said(9'000, 8.0F, 3.0F, 3.0F), ExposureSettings{}), "") << "nothing was asked";
  ExposureSettings of_usb = asked();
  of_usb.red_1e3 = of_usb.blue_1e3 = 0;
  of_usb.white_kelvin = 5'000;
  EXPECT_EQ(drift_of(said(5'000, 2.0F, 3.0F, 3.0F), of_usb), "") << "no gains of the colours were asked";
}

TEST(LibcameraMetadata, WhatIsOffIsNamedWithBothNumbers) {
  EXPECT_EQ(drift_of(said(4'880, 2.0F, 1.5F, 1.2F), asked()), "an exposure of 4880 us, asked 5000");
  EXPECT_EQ(drift_of(said(5'120, 2.0F, 1.5F, 1.2F), asked()), "an exposure of 5120 us, asked 5000");
  EXPECT_EQ(drift_of(said(5'000, 2.25F, 1.5F, 1.2F), asked()), "a gain of 2.250000, asked 2000 thousandths");
  for (const auto& [red, blue] : {std::pair{1.56F, 1.2F}, std::pair{1.5F, 1.15F}}) {
    EXPECT_NE(drift_of(said(5'000, 2.0F, red, blue), asked()).find("asked 1500, 1200 thousandths"), std::string::npos);
  }
}

TEST(LibcameraMetadata, TheStampIsOfTheMiddleOfTheExposure) {
  lc::ControlList list = said(5'000, 2.0F, 1.5F, 1.2F);
  const int64_t start_us = now_ns(CLOCK_MONOTONIC) / 1'000 - 20'000;
  list.set(lc::controls::SensorTimestamp, start_us * 1'000);
  lc::FrameMetadata about{};
  about.timestamp = 1;
  EXPECT_EQ(middle_us(list, about), static_cast<uint64_t>(start_us + 2'500)) << "the sensor's stamp, not the buffer's";
  lc::ControlList bare(lc::controls::controls);
  about.timestamp = static_cast<uint64_t>(start_us) * 1'000;
  EXPECT_EQ(middle_us(bare, about), static_cast<uint64_t>(start_us)) << "the buffer's, of a pipeline without the other";
}

TEST(LibcameraMetadata, AFrameWithoutAStampIsOfNow) {
  const lc::ControlList bare(lc::controls::controls);
  const auto before = static_cast<uint64_t>(now_ns(CLOCK_MONOTONIC) / 1'000);
  const uint64_t told = middle_us(bare, lc::FrameMetadata{});
  EXPECT_GE(told, before);
  EXPECT_LE(told, static_cast<uint64_t>(now_ns(CLOCK_MONOTONIC) / 1'000));
}

}  // namespace
}  // namespace ruffini
