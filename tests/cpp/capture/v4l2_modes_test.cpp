#include "capture/v4l2_modes.h"

#include <gtest/gtest.h>

#include "support/fake_driver.h"

namespace ruffini {
namespace {

TEST(V4l2Modes, DearestFormatFirstAndTheFastestRateOfEachSize) {
  test::FakeDriver driver;
  driver.modes = {{V4L2_PIX_FMT_MJPEG, 640, 480, 60},
                  {V4L2_PIX_FMT_H264, 640, 480, 60},
                  {V4L2_PIX_FMT_YUYV, 640, 480, 15},
                  {V4L2_PIX_FMT_YUYV, 320, 240, 30}};
  const auto modes = v4l2_modes(driver.calls(), 7, 640, 480);
  ASSERT_EQ(modes.size(), 3U);
  EXPECT_EQ(text_of(modes[0].format.fourcc), "YUYV");
  EXPECT_EQ(modes[1].rate_mhz, 30'000);
  EXPECT_EQ(text_of(modes[2].format.fourcc), "MJPG");
  CameraSettings wanted;
  wanted.width_px = 640;
  wanted.height_px = 480;
  wanted.rate_mhz = 60'000;
  const auto fitting = fitting_modes(modes, wanted, "A");
  ASSERT_TRUE(fitting);
  ASSERT_EQ(fitting.value().size(), 1U) << "YUYV is too slow at that size";
  EXPECT_FALSE(fitting.value()[0].format.layout);
  wanted.rate_mhz = 15'200;
  EXPECT_EQ(fitting_modes(modes, wanted, "A").value().size(), 2U) << "2 % are a matter of counting";
}

TEST(V4l2Modes, RangesAndEncodingsOfColour) {
  v4l2_pix_format format{};
  format.colorspace = V4L2_COLORSPACE_SRGB;  // as UVC cameras say: BT.601, limited
  EXPECT_EQ(rule_of(format).gain, kLimited601.gain);
  EXPECT_EQ(rule_of(format).v_to_r, kLimited601.v_to_r);
  format.colorspace = V4L2_COLORSPACE_JPEG;
  EXPECT_EQ(rule_of(format).v_to_r, kFull601.v_to_r);
  format.colorspace = V4L2_COLORSPACE_REC709;
  EXPECT_EQ(rule_of(format).v_to_r, kLimited709.v_to_r);
  format.quantization = V4L2_QUANTIZATION_FULL_RANGE;
  EXPECT_EQ(rule_of(format).v_to_r, kFull709.v_to_r);
  format.ycbcr_enc = V4L2_YCBCR_ENC_601;
  EXPECT_EQ(rule_of(format).v_to_r, kFull601.v_to_r);
}

TEST(V4l2Modes, TheListIsJson) {
  test::FakeDriver driver;
  driver.nodes[0].name = "A \"quoted\" cam";
  driver.modes = {{V4L2_PIX_FMT_YUYV, 320, 240, 25}};
  EXPECT_EQ(cameras_json(driver.calls()),
            "{\"cameras\": [{\"path\": \"/dev/video0\", \"name\": \"A \\\"quoted\\\" cam\", \"serial\": \"S-1\", "
            "\"vendor\": 7531, \"product\": 258, \"problem\": \"\", \"modes\": [{\"format\": \"YUYV\", "
            "\"width_px\": 320, \"height_px\": 240, \"rate_mhz\": 25000}]}]}");
  driver.capabilities = V4L2_CAP_META_CAPTURE;
  EXPECT_EQ(cameras_json(driver.calls()), "{\"cameras\": []}");
  driver.open_error = EACCES;
  EXPECT_NE(cameras_json(driver.calls()).find("\"problem\": \"Permission denied\""), std::string::npos);
}

}  // namespace
}  // namespace ruffini
