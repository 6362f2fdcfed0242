// FEATURES: what the wrench is made of, as the stage that writes it has it.
#include <gtest/gtest.h>
#include <pb_decode.h>

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

TEST(FeaturesMessage, HasTheChangeOfLightCellByCell) {
  test::Scene scene = test::dots();
  const CameraSettings& camera = scene.board.camera;
  const int right = camera.width_px - 1, bottom = camera.height_px - 1;
  scene.board.stages = {"difference", "picture_features", "feature_wrench"};
  scene.board.picture_features = {.corners = {{0, 0}, {right, 0}, {right, bottom}, {0, bottom}},
                                  .cells = {.n_x = 2, .n_y = 1}};
  const auto path = FramePath::configure(scene.board, nullptr, [] { return uint64_t{0}; }).value();
  MessageEncoder encoder(*path, uint8_t{0});
  Bytes grey(static_cast<size_t>(camera.width_px) * static_cast<size_t>(camera.height_px) * 3, 100);
  const FrameView view{grey.data(), camera.width_px, camera.height_px, 3, ptrdiff_t{3} * camera.width_px};
  for (int i = 0; i < scene.board.n_rest_frames; ++i) path->process(view);
  for (size_t i = 0; i < grey.size(); i += 3) {
    const bool is_left = i / 3 % static_cast<size_t>(camera.width_px) < static_cast<size_t>(camera.width_px) / 2;
    if (is_left) grey[i + 2] = 125;  // red, a quarter more
  }
  path->process(view);
  Bytes payload, data;
  FrameDecoder decoder;
  encoder.encode(ruffini_MessageType_MESSAGE_TYPE_FEATURES, *path, view, {.capture_us = 5, .frame = 7},
                 [&](ruffini_MessageType, std::span<const uint8_t> all) {
                   for (const uint8_t byte : all) {
                     const auto frame = decoder.push(byte);
                     if (frame) payload.assign(frame->payload.begin(), frame->payload.end());
                   }
                 });
  ruffini_Features m = ruffini_Features_init_zero;
  m.value.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  pb_istream_t stream = pb_istream_from_buffer(payload.data(), payload.size());
  ASSERT_TRUE(pb_decode(&stream, ruffini_Features_fields, &m)) << PB_GET_ERROR(&stream);
  EXPECT_EQ(m.stamp.frame, 7U);
  EXPECT_EQ(m.stamp.capture_us, 5U);
  EXPECT_EQ(m.value.n_components, 1U);
  const auto values =
      test::decode_dense(m.value.codec == ruffini_Dense_Codec_CODEC_SPARSE, size_t{m.value.n_x} * m.value.n_y, 1, data);
  ASSERT_TRUE(values);
  ASSERT_EQ(values->size(), 6U);
  for (const size_t unchanged : {0U, 1U, 2U, 3U, 5U}) EXPECT_NEAR((*values)[unchanged], 0, 700);
  EXPECT_NEAR((*values)[4], 65'536 / 4, 700);
}

}  // namespace
}  // namespace ruffini
