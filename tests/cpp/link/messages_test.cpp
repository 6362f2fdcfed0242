#include "link/messages.h"

#include <gtest/gtest.h>
#include <pb_decode.h>

#include <cmath>

#include "support/dense_decoder.h"
#include "support/dot_picture.h"
#include "support/test_board.h"
#include "support/test_calibration.h"
#include "support/texture_calibration.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

uint64_t still_clock() { return 0; }

bool read_bytes(pb_istream_t* stream, const pb_field_t*, void** arg) {
  auto& out = *static_cast<Bytes*>(*arg);
  out.resize(stream->bytes_left);
  return pb_read(stream, out.data(), out.size());
}

template <typename Dense>
std::vector<int32_t> values_of(const Dense& dense, const Bytes& data) {
  const auto values = test::decode_dense(dense.codec == ruffini_Dense_Codec_CODEC_SPARSE, size_t{dense.n_x} * dense.n_y,
                                         dense.n_components, data);
  EXPECT_TRUE(values) << "the data is not what its sizes say";
  return values.value_or(std::vector<int32_t>{});
}

// A sensor that has learned rest and sees one press: dots moved to the right, colours bent in the middle.
class MessagesTest : public testing::Test {
 protected:
  explicit MessagesTest(BoardSettings board = all_stages()) : board_(std::move(board)) {
    path_ = FramePath::configure(board_, CalibrationFile::load(test::diagonal_calibration(board_)).value(), still_clock)
                .value();
    auto dots = test::nominal_dots(board_);
    const test::DotPicture picture{.width = board_.camera.width_px, .height = board_.camera.height_px};
    const Bytes rest = picture.bgr(dots, 1);
    for (int i = 0; i < board_.n_rest_frames; ++i) path_->process(view(rest));
    for (test::Place& p : dots) p.x += 2;
    dots.erase(dots.begin() + 5);
    picture_ = picture.bgr(dots, 2);
    for (int y = 40; y < 80; ++y) {
      for (int x = 60; x < 100; ++x) {
        uint8_t& blue = picture_[static_cast<size_t>(3 * (y * board_.camera.width_px + x))];
        blue = static_cast<uint8_t>(std::clamp(blue + (x - 80), 0, 255));
      }
    }
    path_->process(view(picture_));
    encoder_ = std::make_unique<MessageEncoder>(*path_, kSensor);
  }

  static BoardSettings all_stages() {
    BoardSettings board = test::round_board();
    // Contacts of a skin that glows and of a texture are their own.
    board.stages = test::stages_but({"skin", "contact_model", "helmholtz", "contact_depth"});
    return board;
  }
  [[nodiscard]] FrameView view(const Bytes& pixels) const {
    return {pixels.data(), board_.camera.width_px, board_.camera.height_px, 3, ptrdiff_t{3} * board_.camera.width_px};
  }

  // The message of this type about the last frame, its fragments joined; headers_ are theirs.
  Bytes encode(ruffini_MessageType type) {
    headers_.clear();
    Bytes payload;
    encoder_->encode(type, *path_, view(picture_), kStamp, [&](ruffini_MessageType said, std::span<const uint8_t> all) {
      EXPECT_EQ(said, type);
      for (const uint8_t byte : all) {
        const auto frame = decoder_.push(byte);
        if (!frame) continue;
        headers_.push_back(frame->header);
        payload.insert(payload.end(), frame->payload.begin(), frame->payload.end());
      }
    });
    return payload;
  }
  template <typename Message>
  void decode(const Bytes& payload, const pb_msgdesc_t* fields, Message& out) {
    pb_istream_t stream = pb_istream_from_buffer(payload.data(), payload.size());
    ASSERT_TRUE(pb_decode(&stream, fields, &out)) << PB_GET_ERROR(&stream);
    ASSERT_TRUE(out.has_stamp);
    EXPECT_EQ(out.stamp.capture_us, kStamp.capture_us);
    EXPECT_EQ(out.stamp.frame, kStamp.frame);
    EXPECT_EQ(out.stamp.calibration_id, kStamp.calibration_id);
    EXPECT_EQ(out.stamp.flags, path_->state().flags);
  }

  static constexpr uint8_t kSensor = 3;
  static constexpr FrameStamp kStamp{uint64_t{1} << 40, 77, 0xDEADBEEF, kSimulated | kReplay};
  BoardSettings board_;
  std::unique_ptr<FramePath> path_;
  Bytes picture_;
  std::unique_ptr<MessageEncoder> encoder_;
  FrameDecoder decoder_;
  std::vector<FrameHeader> headers_;
};

TEST_F(MessagesTest, EveryHeaderSaysSensorSequenceAndThatItIsSimulated) {
  const ruffini_MessageType types[] = {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_IMAGE,
                                       ruffini_MessageType_MESSAGE_TYPE_FIELD};
  uint32_t sequence = 0;
  for (const auto type : types) {
    encode(type);
    ASSERT_FALSE(headers_.empty());
    for (size_t i = 0; i < headers_.size(); ++i) {
      EXPECT_EQ(headers_[i].type, type);
      EXPECT_EQ(headers_[i].flags, kSimulated | kReplay);
      EXPECT_EQ(headers_[i].sensor, kSensor);
      EXPECT_EQ(headers_[i].sequence, sequence);
      EXPECT_EQ(headers_[i].fragment, i);
      EXPECT_EQ(headers_[i].n_fragments, headers_.size());
    }
    ++sequence;
  }
}

TEST_F(MessagesTest, WhatANetworkSaidCarriesItsOwnFramesStamp) {
  LearnedResult said{.stamp = {123, 70, 9, 0xABCD}, .is_valid = true, .n_values = 2};
  said.value = {-5'000'000'000, 12};
  said.took_us = 600;
  said.latency_us = 900;
  said.period_us = 1'000;
  const std::vector<std::string> names{"force_un", "x_um"};
  for (const bool is_valid : {true, false}) {
    said.is_valid = is_valid;
    Bytes payload;
    encoder_->encode(said, names, kSimulated, [&](ruffini_MessageType type, std::span<const uint8_t> all) {
      EXPECT_EQ(type, ruffini_MessageType_MESSAGE_TYPE_LEARNED);
      for (const uint8_t byte : all) {
        if (const auto frame = decoder_.push(byte)) {
          EXPECT_EQ(frame->header.flags, kSimulated);
          payload.assign(frame->payload.begin(), frame->payload.end());
        }
      }
    });
    ruffini_Learned m = ruffini_Learned_init_zero;
    pb_istream_t stream = pb_istream_from_buffer(payload.data(), payload.size());
    ASSERT_TRUE(pb_decode(&stream, ruffini_Learned_fields, &m));
    EXPECT_EQ(m.stamp.capture_us, 123U);
    EXPECT_EQ(m.stamp.frame, 70U);
    EXPECT_EQ(m.stamp.flags, 9U);
    EXPECT_EQ(m.stamp.calibration_id, 0xABCDU);
    EXPECT_EQ(m.validity, is_valid ? ruffini_Validity_VALIDITY_VALID : ruffini_Validity_VALIDITY_INVALID);
    ASSERT_EQ(m.quantities_count, 2U);
    EXPECT_STREQ(m.quantities[0].name, "force_un");
    EXPECT_EQ(m.quantities[0].value, -5'000'000'000);
    EXPECT_EQ(m.quantities[1].value, 12);
    EXPECT_EQ(m.took_us, 600U);
    EXPECT_EQ(m.latency_us, 900U);
    EXPECT_EQ(m.period_us, 1'000U);
  }
}

TEST_F(MessagesTest, TheWrenchIsTheExactSumOfTheField) {
  ruffini_Wrench wrench = ruffini_Wrench_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_WRENCH), ruffini_Wrench_fields, wrench);
  ruffini_Field field = ruffini_Field_init_zero;
  Bytes force;
  Bytes displacement;
  field.force.data = {.funcs = {.decode = read_bytes}, .arg = &force};
  field.displacement.data = {.funcs = {.decode = read_bytes}, .arg = &displacement};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_FIELD), ruffini_Field_fields, field);

  const std::vector<int32_t> f = values_of(field.force, force);
  int64_t sum[3] = {};
  for (size_t i = 0; i < f.size(); ++i) sum[i % 3] += int64_t{f[i]} * field.force_lsb_un;
  EXPECT_EQ(wrench.force_x_un, sum[0]);
  EXPECT_EQ(wrench.force_y_un, sum[1]);
  EXPECT_EQ(wrench.force_z_un, sum[2]);
  EXPECT_NE(sum[0], 0);
  EXPECT_NE(sum[2], 0);

  const std::vector<int32_t> u = values_of(field.displacement, displacement);
  const auto& nodes = path_->state().displacement.node;
  ASSERT_EQ(u.size(), 3 * nodes.size());
  for (size_t i = 0; i < nodes.size(); ++i) {
    EXPECT_EQ(u[3 * i], nodes[i].x.raw());
    EXPECT_EQ(u[3 * i + 2], nodes[i].z.raw());
  }
}

TEST_F(MessagesTest, ValidityIsBesideEveryNumber) {
  ruffini_Wrench wrench = ruffini_Wrench_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_WRENCH), ruffini_Wrench_fields, wrench);
  ASSERT_EQ(wrench.validity_count, 6);
  for (const auto validity : wrench.validity) EXPECT_EQ(validity, ruffini_Validity_VALIDITY_VALID);
  // Without a calibration nothing is a force.
  auto bare = FramePath::configure(board_, nullptr, still_clock).value();
  bare->process(view(picture_));
  path_.swap(bare);
  wrench = ruffini_Wrench_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_WRENCH), ruffini_Wrench_fields, wrench);
  ASSERT_EQ(wrench.validity_count, 6);
  for (const auto validity : wrench.validity) EXPECT_EQ(validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_EQ(wrench.force_x_un, 0);
}

TEST_F(MessagesTest, DepthIsTheStatesOwn) {
  ruffini_Depth depth = ruffini_Depth_init_zero;
  Bytes data;
  depth.depth.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_DEPTH), ruffini_Depth_fields, depth);
  EXPECT_EQ(depth.validity, ruffini_Validity_VALIDITY_VALID);
  EXPECT_EQ(depth.sigma_um, 0U) << "light states none";
  const std::vector<int32_t> z = values_of(depth.depth, data);
  const auto& state = path_->state().depth.cell;
  ASSERT_EQ(z.size(), state.size());
  for (size_t i = 0; i < z.size(); ++i) ASSERT_EQ(z[i], state[i].raw());
  EXPECT_NE(*std::min_element(z.begin(), z.end()), 0);
}

TEST_F(MessagesTest, ATexturesDepthMapHasItsOwnStepAndSigma) {
  board_ = test::contact_board();
  const auto file = CalibrationFile::load(test::contact_calibration(board_)).value();
  path_ = FramePath::configure(board_, file, still_clock).value();
  encoder_ = std::make_unique<MessageEncoder>(*path_, kSensor);
  for (const double out_px : {0.0, 0.0, 1.5, 0.0}) {
    path_->process(view(test::speckles(board_, out_px)));
    ruffini_Depth depth = ruffini_Depth_init_zero;
    Bytes data;
    depth.depth.data = {.funcs = {.decode = read_bytes}, .arg = &data};
    decode(encode(ruffini_MessageType_MESSAGE_TYPE_DEPTH), ruffini_Depth_fields, depth);
    EXPECT_EQ(depth.step_px, 15U) << "the patches' pitch";
    EXPECT_EQ(depth.sigma_um, 95U);
    const std::vector<int32_t> z = values_of(depth.depth, data);
    ASSERT_EQ(z.size(), 80U);
    for (size_t i = 0; i < z.size(); ++i) ASSERT_EQ(z[i], path_->state().depth.cell[i].raw());
    EXPECT_EQ(*std::min_element(z.begin(), z.end()) < -100, out_px > 0) << "nothing touches: zeros";
    if (out_px > 0) {
      EXPECT_EQ(depth.validity, ruffini_Validity_VALIDITY_VALID);
    }
  }
}

TEST_F(MessagesTest, MarkersAreInMillionthsOfAPixelAndTheLostOneIsMarked) {
  ruffini_Markers markers = ruffini_Markers_init_zero;
  Bytes data;
  markers.displacement.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_MARKERS), ruffini_Markers_fields, markers);
  EXPECT_EQ(markers.n_x, 9U);
  EXPECT_EQ(markers.n_y, 7U);
  const std::vector<int32_t> moved = values_of(markers.displacement, data);
  ASSERT_EQ(moved.size(), 2U * 63U);
  ASSERT_EQ(markers.lost.size, 8U);
  for (size_t i = 0; i < 63; ++i) {
    EXPECT_NEAR(moved[2 * i] * static_cast<double>(markers.position_lsb_upx) / 1e6, 2.0, 0.1) << i;
    EXPECT_EQ(markers.lost.bytes[i / 8] >> i % 8 & 1, i == 5 ? 1 : 0) << i;
  }
}

TEST_F(MessagesTest, QualityIsSentOfDotsAndOfTextures) {
  ruffini_Markers markers = ruffini_Markers_init_zero;
  Bytes data;
  markers.quality.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_MARKERS), ruffini_Markers_fields, markers);
  ASSERT_TRUE(markers.has_quality);
  const std::vector<int32_t> of_dots = values_of(markers.quality, data);
  ASSERT_EQ(of_dots.size(), path_->markers().size());
  for (size_t i = 0; i < of_dots.size(); ++i) {
    EXPECT_EQ(of_dots[i], path_->markers()[i].quality) << i;
    EXPECT_EQ(of_dots[i] == 0, path_->markers()[i].is_lost) << i;
  }

  BoardSettings textured = board_;
  textured.markers.polarity = Polarity::kTexture;
  path_ = FramePath::configure(textured, nullptr, still_clock).value();
  std::vector<uint8_t> speckle(picture_.size());
  uint32_t random = 1;
  for (uint8_t& v : speckle) v = static_cast<uint8_t>((random = random * 1'664'525 + 1'013'904'223) >> 25);
  for (int i = 0; i <= board_.n_rest_frames; ++i) path_->process(view(speckle));
  markers = ruffini_Markers_init_zero;
  markers.quality.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  data.clear();
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_MARKERS), ruffini_Markers_fields, markers);
  ASSERT_TRUE(markers.has_quality);
  const std::vector<int32_t> quality = values_of(markers.quality, data);
  ASSERT_EQ(quality.size(), path_->markers().size());
  for (size_t i = 0; i < quality.size(); ++i) EXPECT_EQ(quality[i], path_->markers()[i].quality) << i;
  EXPECT_GT(*std::max_element(quality.begin(), quality.end()), 200);
}

TEST_F(MessagesTest, TargetsSendTheChangeOfTheirAreaAndDotsSendNone) {
  ruffini_Markers markers = ruffini_Markers_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_MARKERS), ruffini_Markers_fields, markers);
  EXPECT_FALSE(markers.has_area);

  BoardSettings tray = board_;
  tray.stages = {"difference", "targets"};
  tray.targets = {
      .places = {{4'000, 4'000}, {12'000, 4'000}, {8'000, 8'500}}, .diameter_um = 2'800, .threshold_1e3 = 400};
  const std::vector<test::Place> at = {{39.5, 39.5}, {119.5, 39.5}, {79.5, 84.5}};
  test::DotPicture disc{.gradient = 0, .contrast = 0.8, .diameter_px = 28, .noise = 0};
  path_ = FramePath::configure(tray, nullptr, still_clock).value();
  encoder_ = std::make_unique<MessageEncoder>(*path_, kSensor);
  const Bytes rest = disc.bgr(at, 1);
  for (int i = 0; i < tray.n_rest_frames; ++i) path_->process(view(rest));
  for (const double diameter_px : {30.0, 26.0}) {  // nearer, further away; the third is covered
    disc.diameter_px = diameter_px;
    path_->process(view(disc.bgr({{at[0].x + 2, at[0].y - 1}, at[1]}, 1)));
    markers = ruffini_Markers_init_zero;
    Bytes moved_data;
    Bytes area_data;
    markers.displacement.data = {.funcs = {.decode = read_bytes}, .arg = &moved_data};
    markers.area.data = {.funcs = {.decode = read_bytes}, .arg = &area_data};
    decode(encode(ruffini_MessageType_MESSAGE_TYPE_MARKERS), ruffini_Markers_fields, markers);
    EXPECT_EQ(markers.n_x, 3U);
    EXPECT_EQ(markers.n_y, 1U);
    ASSERT_EQ(markers.lost.size, 1U);
    EXPECT_EQ(markers.lost.bytes[0], 4);
    EXPECT_FALSE(markers.has_quality);
    ASSERT_TRUE(markers.has_area);
    EXPECT_EQ(markers.area.n_components, 1U);
    const std::vector<int32_t> area = values_of(markers.area, area_data);
    ASSERT_EQ(area.size(), 3U);
    const double wanted_px2 = std::acos(-1.0) / 4 * (diameter_px * diameter_px - 28.0 * 28.0);
    for (size_t i = 0; i < 2; ++i) {
      const Target& target = path_->targets()[i];
      EXPECT_EQ(area[i], target.now.area_q8 - target.rest.area_q8) << i;
      EXPECT_NEAR(area[i] / 256.0, wanted_px2, 0.05 * std::abs(wanted_px2)) << i;
    }
    const std::vector<int32_t> moved = values_of(markers.displacement, moved_data);
    ASSERT_EQ(moved.size(), 6U);
    const double lsb_px = markers.position_lsb_upx * 1e-6;
    EXPECT_NEAR(moved[0] * lsb_px, 2.0, 0.05);
    EXPECT_NEAR(moved[1] * lsb_px, -1.0, 0.05);
    EXPECT_NEAR(moved[2] * lsb_px, 0.0, 0.05);
  }
}

TEST_F(MessagesTest, ContactsAreTheStatesOwn) {
  ruffini_Contacts contacts = ruffini_Contacts_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_CONTACTS), ruffini_Contacts_fields, contacts);
  const ContactList& found = path_->state().contacts;
  ASSERT_GE(found.n_listed, 1);
  ASSERT_EQ(contacts.contacts_count, found.n_listed);
  EXPECT_EQ(contacts.n_found, static_cast<uint32_t>(found.n_found));
  EXPECT_LT(contacts.contacts[0].force_z_un, 0) << "pressing is negative";
  EXPECT_EQ(contacts.contacts[0].force_z_un, found.contacts[0].force_z_un);
  EXPECT_EQ(contacts.contacts[0].center_x_um, found.contacts[0].center_x_um);
  EXPECT_EQ(contacts.contacts[0].area_um2_k, found.contacts[0].area_um2 / 1'000);
  EXPECT_FALSE(contacts.contacts[0].has_slip) << "one frame tells nothing";
}

TEST_F(MessagesTest, SlipIsTheStatesOwn) {
  // A press of 7 x 7 nodes whose rim stays behind, forces straight from the diagonal operator.
  BoardSettings linear = board_;
  std::erase(linear.stages, "support");
  auto path =
      FramePath::configure(linear, CalibrationFile::load(test::diagonal_calibration(board_)).value(), still_clock)
          .value();
  path->set_rest(path_->rest_image());
  path->process(view(picture_));
  path_.swap(path);
  for (const int core_um : {0, 40}) {
    std::vector<NodeDisplacement> u(17 * 13);
    for (int y = 3; y < 10; ++y) {
      for (int x = 5; x < 12; ++x) {
        const bool is_core = y > 4 && y < 8 && x > 6 && x < 10;
        const int ux = is_core ? core_um : core_um / 2;
        u[static_cast<size_t>(17 * y + x)] = {
            DisplacementUm::from_raw(static_cast<int16_t>(8 * ux)), {}, DisplacementUm::from_raw(-800)};
      }
    }
    path_->solve(u);
  }
  const ContactSlip& slip = path_->state().slip.contact[0];
  ASSERT_EQ(slip.state, SlipState::kIncipient);
  ruffini_Contacts contacts = ruffini_Contacts_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_CONTACTS), ruffini_Contacts_fields, contacts);
  ASSERT_TRUE(contacts.contacts[0].has_slip);
  const ruffini_Slip& sent = contacts.contacts[0].slip;
  EXPECT_EQ(static_cast<int>(sent.slip_state), static_cast<int>(slip.state));
  EXPECT_EQ(sent.shear_ratio_1e3, static_cast<uint32_t>(slip.ratio_1e3));
  EXPECT_EQ(sent.friction_1e3, static_cast<uint32_t>(slip.friction_1e3));
  EXPECT_EQ(sent.friction_sigma_1e3, static_cast<uint32_t>(slip.friction_sigma_1e3));
  EXPECT_EQ(sent.slip_share_1e3, static_cast<uint32_t>(slip.share_1e3));
  EXPECT_EQ(sent.slip_margin_un, slip.margin_un);
  ruffini_Field field = ruffini_Field_init_zero;
  Bytes data;
  field.slip.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_FIELD), ruffini_Field_fields, field);
  const std::vector<int32_t> nodes = values_of(field.slip, data);
  const auto expected = path_->state().slip.node;
  ASSERT_EQ(nodes.size(), expected.size());
  for (size_t i = 0; i < nodes.size(); ++i) ASSERT_EQ(nodes[i], static_cast<int32_t>(expected[i]));
  EXPECT_NE(*std::max_element(nodes.begin(), nodes.end()), 0);
}

TEST_F(MessagesTest, SlipOfForcesThatAreNotValidIsNotSent) {
  auto bare = FramePath::configure(board_, nullptr, still_clock).value();
  bare->process(view(picture_));
  path_.swap(bare);
  ruffini_Field field = ruffini_Field_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_FIELD), ruffini_Field_fields, field);
  EXPECT_FALSE(field.has_slip);
}

TEST_F(MessagesTest, HowSureTravelsAsItIs) {
  const auto& stated = path_->state().uncertainty;
  ASSERT_TRUE(stated.is_stated);
  ruffini_Wrench wrench = ruffini_Wrench_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_WRENCH), ruffini_Wrench_fields, wrench);
  EXPECT_EQ(wrench.covariance_validity, ruffini_Validity_VALIDITY_VALID);
  ASSERT_EQ(wrench.covariance_count, WrenchCovariance::kSize);
  const auto& upper = path_->state().covariance.wrench.upper;
  EXPECT_TRUE(std::equal(upper.begin(), upper.end(), wrench.covariance));
  EXPECT_GT(wrench.covariance[0], 0);
  ruffini_Field field = ruffini_Field_init_zero;
  Bytes data;
  field.sigma.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_FIELD), ruffini_Field_fields, field);
  EXPECT_EQ(field.sigma_validity, ruffini_Validity_VALIDITY_VALID);
  const std::vector<int32_t> sent = values_of(field.sigma, data);
  ASSERT_EQ(sent.size(), 3 * stated.node.size());
  for (size_t i = 0; i < stated.node.size(); ++i) {
    ASSERT_EQ(sent[3 * i], stated.node[i].x);
    ASSERT_EQ(sent[3 * i + 1], stated.node[i].y);
    ASSERT_EQ(sent[3 * i + 2], stated.node[i].z);
    ASSERT_GE(sent[3 * i], 5);
    const NodeForce& f = path_->state().solve.force[i];
    if (f.x == 0 && f.y == 0 && f.z == 0) {
      ASSERT_GE(sent[3 * i + 2], sent[3 * i] + 1) << "a quiet node: 5 and 6 steps";
    }
  }
}

TEST_F(MessagesTest, WithoutAnErrorModelUncertaintyIsAbsentAndNotMeasured) {
  auto bare = FramePath::configure(board_, nullptr, still_clock).value();
  bare->process(view(picture_));
  path_.swap(bare);
  ruffini_Wrench wrench = ruffini_Wrench_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_WRENCH), ruffini_Wrench_fields, wrench);
  EXPECT_EQ(wrench.covariance_validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_EQ(wrench.covariance_count, 0U);
  ruffini_Field field = ruffini_Field_init_zero;
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_FIELD), ruffini_Field_fields, field);
  EXPECT_EQ(field.sigma_validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_FALSE(field.has_sigma);
}

TEST_F(MessagesTest, AnImageTravelsAsItIs) {
  ruffini_Image image = ruffini_Image_init_zero;
  Bytes data;
  image.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_IMAGE), ruffini_Image_fields, image);
  EXPECT_EQ(image.step_px, 1U);
  EXPECT_EQ(data, picture_);
}

// Lengths in steps of a pixel, from less than one part of a message to more than two.
TEST_F(MessagesTest, AnyLengthIsSplitIntoFullPartsAndANonEmptyRemainder) {
  const Bytes pixels(3 * 3'000, 7);
  size_t n_exact = 0;
  for (int width = 1'300; width < 2'800; ++width) {
    std::vector<size_t> part;
    size_t n_fragments = 0;
    encoder_->encode(ruffini_MessageType_MESSAGE_TYPE_IMAGE, *path_, {pixels.data(), width, 1, 3, 3 * width}, kStamp,
                     [&](ruffini_MessageType, std::span<const uint8_t> all) {
                       for (const uint8_t byte : all) {
                         const auto frame = decoder_.push(byte);
                         if (!frame) continue;
                         EXPECT_EQ(frame->header.fragment, part.size());
                         part.push_back(frame->payload.size());
                         n_fragments = frame->header.n_fragments;
                       }
                     });
    ASSERT_FALSE(part.empty()) << width;
    ASSERT_EQ(part.size(), n_fragments) << width;
    for (size_t i = 0; i + 1 < part.size(); ++i) ASSERT_EQ(part[i], kMaxPayloadBytes) << width;
    ASSERT_GT(part.back(), 0U) << width;
    if (part.back() == kMaxPayloadBytes) ++n_exact;
  }
  EXPECT_GT(n_exact, 0U) << "no message ends where a part does";
}

TEST_F(MessagesTest, TypesThatAreNotAboutAFrameAreNotEncoded) {
  for (const auto type : {ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_MessageType_MESSAGE_TYPE_STATUS,
                          ruffini_MessageType_MESSAGE_TYPE_NONE}) {
    encode(type);
    EXPECT_TRUE(headers_.empty()) << type;
  }
}

class LargeImageTest : public MessagesTest {
 protected:
  LargeImageTest() : MessagesTest(large_board()) {}
  static BoardSettings large_board() {
    BoardSettings board = all_stages();
    board.camera.width_px = 900;
    board.camera.height_px = 602;
    board.depth.step_px = 2;
    return board;
  }
};

TEST_F(LargeImageTest, IsDecimatedUntilItFitsOneMessage) {
  ruffini_Image image = ruffini_Image_init_zero;
  Bytes data;
  image.data = {.funcs = {.decode = read_bytes}, .arg = &data};
  decode(encode(ruffini_MessageType_MESSAGE_TYPE_IMAGE), ruffini_Image_fields, image);
  EXPECT_EQ(image.step_px, 2U);
  EXPECT_EQ(image.width_px, 450U);
  EXPECT_EQ(image.height_px, 301U);
  ASSERT_EQ(data.size(), size_t{450 * 301 * 3});
  Bytes expected;
  for (size_t y = 0; y < 602; y += 2) {
    for (size_t x = 0; x < 900; x += 2) {
      const auto pixel = picture_.begin() + static_cast<ptrdiff_t>(3 * (y * 900 + x));
      expected.insert(expected.end(), pixel, pixel + 3);
    }
  }
  EXPECT_EQ(data, expected);
}

TEST(WriteFrames, AMessageOfMoreThan255FragmentsIsNotWritten) {
  const Bytes largest(255 * kMaxPayloadBytes);
  Bytes out(frames_bound(largest.size() + kMaxPayloadBytes));
  EXPECT_GT(write_frames(ruffini_MessageType_MESSAGE_TYPE_IMAGE, 0, 0, 0, largest, out), largest.size());
  const Bytes beyond(largest.size() + 1);
  EXPECT_EQ(write_frames(ruffini_MessageType_MESSAGE_TYPE_IMAGE, 0, 0, 0, beyond, out), 0U);
}

}  // namespace
}  // namespace ruffini
