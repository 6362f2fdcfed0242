// RESIDUAL: found when it is asked for, and of that frame alone.
#include <gtest/gtest.h>
#include <pb_decode.h>

#include <algorithm>
#include <memory>

#include "link/messages.h"
#include "support/dense_decoder.h"
#include "support/scenes.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

bool read_bytes(pb_istream_t* stream, const pb_field_t*, void** arg) {
  auto& out = *static_cast<Bytes*>(*arg);
  out.resize(stream->bytes_left);
  return pb_read(stream, out.data(), out.size());
}

class ResidualMessage : public testing::Test {
 protected:
  ResidualMessage() : scene_(test::dots()) {
    for (const char* other : {"skin", "contact_model", "helmholtz", "contact_depth"})
      std::erase(scene_.board.stages, other);
    const auto file = CalibrationFile::load(scene_.calibration).value();
    path_ = FramePath::configure(scene_.board, file, [] { return uint64_t{0}; }).value();
    encoder_ = std::make_unique<MessageEncoder>(*path_, uint8_t{0});
  }

  [[nodiscard]] FrameView view(const Bytes& pixels) const {
    const CameraSettings& camera = scene_.board.camera;
    return {pixels.data(), camera.width_px, camera.height_px, 3, ptrdiff_t{3} * camera.width_px};
  }

  // The message about the last frame; values_ are its numbers.
  ruffini_Residual say() {
    Bytes payload, data;
    encoder_->encode(ruffini_MessageType_MESSAGE_TYPE_RESIDUAL, *path_, view(scene_.rest),
                     {.capture_us = 0, .frame = 7}, [&](ruffini_MessageType, std::span<const uint8_t> all) {
                       for (const uint8_t byte : all) {
                         const auto frame = decoder_.push(byte);
                         if (frame) payload.insert(payload.end(), frame->payload.begin(), frame->payload.end());
                       }
                     });
    ruffini_Residual m = ruffini_Residual_init_zero;
    m.residual.data = {.funcs = {.decode = read_bytes}, .arg = &data};
    pb_istream_t stream = pb_istream_from_buffer(payload.data(), payload.size());
    EXPECT_TRUE(pb_decode(&stream, ruffini_Residual_fields, &m)) << PB_GET_ERROR(&stream);
    values_.clear();
    if (m.has_residual) {
      values_ = test::decode_dense(m.residual.codec == ruffini_Dense_Codec_CODEC_SPARSE,
                                   size_t{m.residual.n_x} * m.residual.n_y, m.residual.n_components, data)
                    .value_or(std::vector<int32_t>{});
    }
    return m;
  }

  test::Scene scene_;
  std::unique_ptr<FramePath> path_;
  std::unique_ptr<MessageEncoder> encoder_;
  FrameDecoder decoder_;
  std::vector<int32_t> values_;
};

TEST_F(ResidualMessage, IsFoundWhenItIsAskedForAndOfThatFrameAlone) {
  path_->process(view(scene_.rest));
  path_->compute_residual();
  EXPECT_EQ(say().validity, ruffini_Validity_VALIDITY_NOT_MEASURED) << "rest is being learned";
  for (int i = 1; i < scene_.board.n_rest_frames; ++i) path_->process(view(scene_.rest));
  path_->process(view(scene_.pressed));
  EXPECT_FALSE(say().has_residual) << "a frame does not find it by itself";
  path_->compute_residual();
  const ruffini_Residual m = say();
  EXPECT_EQ(m.stamp.frame, 7U);
  EXPECT_EQ(m.validity, ruffini_Validity_VALIDITY_VALID);
  EXPECT_EQ(m.residual_lsb_1e6, 15'625U);
  EXPECT_EQ(m.residual.n_components, 3U);
  EXPECT_EQ(values_, path_->state().residual.node);
  EXPECT_NE(*std::max_element(values_.begin(), values_.end()), 0);
  path_->process(view(scene_.pressed));
  EXPECT_FALSE(say().has_residual) << "that was the frame before";
}

TEST_F(ResidualMessage, OfAWrongFrameIsInvalidAndWithoutASecondPassAbsent) {
  for (int i = 0; i < scene_.board.n_rest_frames; ++i) path_->process(view(scene_.rest));
  const Bytes dark(scene_.rest.size(), 0);
  path_->process(view(dark));
  path_->compute_residual();
  EXPECT_EQ(say().validity, ruffini_Validity_VALIDITY_INVALID);
  path_ = FramePath::configure(scene_.board, nullptr, [] { return uint64_t{0}; }).value();
  for (int i = 0; i <= scene_.board.n_rest_frames; ++i) path_->process(view(scene_.rest));
  path_->compute_residual();
  EXPECT_EQ(say().validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
}

}  // namespace
}  // namespace ruffini
