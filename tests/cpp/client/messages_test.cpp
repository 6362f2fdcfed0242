// The C++ consumer's messages: golden bytes, numbers that are not valid, and what is no message.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#include "link/frame_codec.h"
#include "ruffini/client.h"
#include "support/vectors.h"

namespace ruffini::client {
namespace {

using Payload = std::vector<uint8_t>;

// A message of a device, through frames and all.
Packet packet(uint8_t type, const Payload& payload) {
  Decoder decoder;
  std::optional<Packet> got;
  const size_t n_parts = std::max<size_t>((payload.size() + kMaxPayloadBytes - 1) / kMaxPayloadBytes, 1);
  for (size_t i = 0; i < n_parts; ++i) {
    const auto begin = payload.begin() + static_cast<ptrdiff_t>(i * kMaxPayloadBytes);
    const auto end = i + 1 < n_parts ? begin + kMaxPayloadBytes : payload.end();
    const Payload part(begin, end);
    std::array<uint8_t, kMaxFrameBytes> out;
    const FrameHeader header{0, type, 0, 0, static_cast<uint8_t>(i), static_cast<uint8_t>(n_parts)};
    const size_t n = encode_frame(header, part, out);
    for (auto& p : decoder.feed(out.data(), n)) got = std::move(p);
  }
  EXPECT_TRUE(got);
  EXPECT_EQ(decoder.counters().undecodable, std::holds_alternative<std::monostate>(got->message) ? 1U : 0U);
  return std::move(*got);
}

Payload golden(const std::string& name) {
  for (const auto& v : ruffini::test::read_vectors(RUFFINI_VECTORS_DIR "/frames.txt")) {
    if (v[0] == name) return ruffini::test::from_hex(v[2].substr(v[2].find("payload=") + 8));
  }
  ADD_FAILURE() << name;
  return {};
}

TEST(ClientMessages, AWrenchAndHowSureItIs) {
  const Packet p = packet(4, golden("wrench and how sure it is"));
  const auto& w = std::get<Wrench>(p.message);
  EXPECT_DOUBLE_EQ(w.force_n[2].value, -1e-3);
  EXPECT_EQ(w.force_n[0].validity, Validity::kValid);
  ASSERT_TRUE(w.covariance);
  const auto& c = *w.covariance;
  EXPECT_DOUBLE_EQ(c[0][0], 4e-12);
  EXPECT_DOUBLE_EQ(c[2][3], -98e-15);  // uN x uN mm
  EXPECT_DOUBLE_EQ(c[3][2], -98e-15);
  EXPECT_DOUBLE_EQ(c[3][3], 260e-18);
  EXPECT_DOUBLE_EQ(c[5][5], 25e-18);
}

TEST(ClientMessages, WhatTheForcesDoNotExplain) {
  const Payload sent = golden("what the forces do not explain");
  const Packet p = packet(16, sent);
  const auto& r = std::get<Residual>(p.message);
  ASSERT_EQ(r.residual_steps.n_nodes(), 2U);
  EXPECT_EQ(r.sigmas_at(0), (std::array<double, 3>{-1, 0.5, 0}));
  EXPECT_EQ(r.sigmas_at(1), (std::array<double, 3>{8, -2, 0.25}));
  Payload invalid = sent;
  invalid.back() = 3;
  const Packet wrong = packet(16, invalid);
  EXPECT_TRUE(std::isnan(std::get<Residual>(wrong.message).sigmas_at(1)[0]));
  const Packet none = packet(16, {0x20, 1});  // VALID, and not one number
  EXPECT_EQ(std::get<Residual>(none.message).validity, Validity::kNotMeasured);
}

TEST(ClientMessages, WithoutAValidityThereIsNoNumber) {
  const Packet p = packet(4, golden("wrench, simulated replay"));
  const auto& w = std::get<Wrench>(p.message);
  EXPECT_EQ(w.stamp.capture_us, 1000U);
  EXPECT_EQ(w.stamp.frame, 1U);
  EXPECT_EQ(w.force_n[0].validity, Validity::kNotMeasured);
  EXPECT_TRUE(std::isnan(w.force_n[0].value));
  EXPECT_DOUBLE_EQ(w.force_n[0].as_sent, -10e-6);
  EXPECT_FALSE(w.covariance);
}

TEST(ClientMessages, AnUnknownFlagOrValidityMakesANumberInvalid) {
  const Payload valid = {0x10, 7, 0x42, 6, 1, 1, 1, 1, 1, 9};  // force_x -4 uN, six validities, the last unknown
  auto w = std::get<Wrench>(packet(4, valid).message);
  EXPECT_DOUBLE_EQ(w.force_n[0].value, -4e-6);
  EXPECT_EQ(w.torque_n_m[2].validity, Validity::kInvalid);
  Payload flagged = valid;  // Stamp after the values: flags 1 << 19
  const Payload stamp = {0x0A, 4, 0x18, 0x80, 0x80, 0x20};
  flagged.insert(flagged.end(), stamp.begin(), stamp.end());
  w = std::get<Wrench>(packet(4, flagged).message);
  EXPECT_EQ(w.stamp.flags, 1U << 19);
  EXPECT_EQ(w.force_n[0].validity, Validity::kInvalid);
  EXPECT_TRUE(std::isnan(w.force_n[0].value));
  EXPECT_DOUBLE_EQ(w.force_n[0].as_sent, -4e-6);
}

TEST(ClientMessages, AFieldAndHowSureItIs) {
  const Packet p = packet(5, golden("field and how sure it is"));
  const auto& f = std::get<Field>(p.message);
  ASSERT_EQ(f.force_steps.n_nodes(), 2U);
  EXPECT_DOUBLE_EQ(f.force_n_at(0)[2], -3e-3);
  EXPECT_DOUBLE_EQ(f.force_n_at(1)[0], 0.0);
  EXPECT_DOUBLE_EQ(f.sigma_n_at(1)[2], 90e-6);
  Field invalid = f;
  invalid.validity[2] = Validity::kInvalid;
  EXPECT_TRUE(std::isnan(invalid.sigma_n_at(1)[2]));
  EXPECT_FALSE(std::isnan(invalid.sigma_n_at(1)[0]));
  EXPECT_TRUE(std::isnan(f.displacement_m_at(0)[0]));  // not sent
  EXPECT_TRUE(f.slip.values.empty());
}

TEST(ClientMessages, AContactThatBeginsToSlip) {
  const Packet p = packet(7, golden("contact that begins to slip"));
  const auto& c = std::get<Contacts>(p.message);
  ASSERT_EQ(c.contacts.size(), 1U);
  EXPECT_EQ(c.contacts[0].slip_state, SlipState::kIncipient);
  EXPECT_DOUBLE_EQ(c.contacts[0].shear_ratio, 0.35);
  EXPECT_DOUBLE_EQ(c.contacts[0].friction, 0.5);
  EXPECT_DOUBLE_EQ(c.contacts[0].slip_margin_n, 25e-3);
  EXPECT_EQ(c.n_found, 1U);
  EXPECT_TRUE(std::isnan(c.contacts[0].force_n[2].value));

  Payload flagged = golden("contact that begins to slip");
  const Payload stamp = {0x0A, 4, 0x18, 0x80, 0x80, 0x20};  // flags 1 << 19, which this library does not know
  flagged.insert(flagged.end(), stamp.begin(), stamp.end());
  const Packet unknown = packet(7, flagged);
  const Contact& untold = std::get<Contacts>(unknown.message).contacts.at(0);
  EXPECT_EQ(untold.slip_state, SlipState::kNotMeasured);
  EXPECT_TRUE(std::isnan(untold.slip_margin_n));
}

TEST(ClientMessages, AContactWithAllThatStagesAdd) {
  const Packet p = packet(7, golden("contact with all that stages add"));
  const Contact& c = std::get<Contacts>(p.message).contacts.at(0);
  EXPECT_TRUE(c.reaches_border);
  ASSERT_TRUE(c.skin && c.tool && c.model && c.flow_parts);
  EXPECT_DOUBLE_EQ(c.skin->place_m[1], -2e-6);
  EXPECT_DOUBLE_EQ(c.skin->normal_force_n[2], 6e-6);
  EXPECT_DOUBLE_EQ(c.skin->force_sigma_n, 7e-6);
  EXPECT_DOUBLE_EQ(c.skin->center_sigma_m, 8e-6);
  EXPECT_DOUBLE_EQ(c.tool->way_m, 13e-6);
  EXPECT_DOUBLE_EQ(c.tool->pitch_rad, -15e-6);
  EXPECT_DOUBLE_EQ(c.tool->normal_force_n[0], 16e-6);
  EXPECT_DOUBLE_EQ(c.tool->way_sigma_m, 24e-6);
  EXPECT_DOUBLE_EQ(c.tool->face_area_sigma_m2, 27e-9);
  EXPECT_DOUBLE_EQ(c.tool->flat_area_m2, 28e-9);
  EXPECT_EQ(c.model->kind, ContactKind::kHertzian);
  EXPECT_DOUBLE_EQ(c.model->kind_confidence, 0.87);
  EXPECT_DOUBLE_EQ(c.model->gel_depth_m, 31e-6);
  EXPECT_DOUBLE_EQ(c.model->shore_a, 36.0);
  EXPECT_DOUBLE_EQ(c.model->stiffness_pa_per_m, -35e6);
  EXPECT_DOUBLE_EQ(c.flow_parts->twist_rad, -43e-6);
  EXPECT_EQ(c.slip_state, SlipState::kNotMeasured) << "not sent";

  Payload flagged = golden("contact with all that stages add");
  const Payload stamp = {0x0A, 4, 0x18, 0x80, 0x80, 0x20};  // flags 1 << 19, which this library does not know
  flagged.insert(flagged.end(), stamp.begin(), stamp.end());
  const Packet unknown = packet(7, flagged);
  const Contact& doubted = std::get<Contacts>(unknown.message).contacts.at(0);
  EXPECT_TRUE(std::isnan(doubted.skin->place_m[0]));
  EXPECT_TRUE(std::isnan(doubted.tool->roll_rad));
  EXPECT_TRUE(std::isnan(doubted.model->shore_a));
  EXPECT_EQ(doubted.model->hardness_validity, Validity::kInvalid);
}

void put_varint(Payload& out, uint64_t v) {
  for (; v > 127; v >>= 7) out.push_back(static_cast<uint8_t>(v | 128));
  out.push_back(static_cast<uint8_t>(v));
}

// A DEPTH with this Dense.
Payload depth_of(uint64_t codec, uint64_t n_x, uint64_t n_y, uint64_t n_components, const Payload& data) {
  Payload dense;
  const uint64_t numbers[] = {codec, n_x, n_y, n_components};
  for (uint8_t i = 0; i < 4; ++i) {
    dense.push_back(static_cast<uint8_t>((i + 1) << 3));
    put_varint(dense, numbers[i]);
  }
  dense.push_back(5 << 3 | 2);
  put_varint(dense, data.size());
  dense.insert(dense.end(), data.begin(), data.end());
  Payload out = {0x10, 0x64, 0x28, 0x01, 0x22};  // steps of 100 nm, VALID
  put_varint(out, dense.size());
  out.insert(out.end(), dense.begin(), dense.end());
  return out;
}

TEST(ClientMessages, NodeValuesAreWhatTheGoldenBytesSay) {
  int n_good = 0, n_bad = 0;
  for (const auto& v : ruffini::test::read_vectors(RUFFINI_VECTORS_DIR "/dense.txt")) {
    const uint64_t n_components = std::stoull(v[3]);
    // A DEPTH has one component: the same values in a row are the same bytes, but for the bitmap of the sparse.
    if (v[1] != "0" && n_components != 1) continue;
    const Payload data = ruffini::test::from_hex(v[4]);
    const Packet p = packet(6, depth_of(std::stoull(v[1]), std::stoull(v[2]) * n_components, 1, 1, data));
    if (v[5] == "error") {
      EXPECT_TRUE(std::holds_alternative<std::monostate>(p.message)) << v[0];
      ++n_bad;
      continue;
    }
    ASSERT_TRUE(std::holds_alternative<Depth>(p.message)) << v[0];
    std::ostringstream said;
    for (const int32_t value : std::get<Depth>(p.message).depth_steps.values)
      said << (said.tellp() > 0 ? "," : "") << value;
    EXPECT_EQ(said.str(), v[5]) << v[0];
    ++n_good;
  }
  EXPECT_GE(n_good, 7);
  EXPECT_GE(n_bad, 4);
}

TEST(ClientMessages, SparseNodesOfThreeComponents) {
  const Payload data = {4, 4, 10, 13, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};  // the specification's example
  Payload field = depth_of(1, 4, 1, 3, data);
  field.erase(field.begin(), field.begin() + 4);
  field[0] = 0x1A;  // Field.force
  const Packet p = packet(5, field);
  ASSERT_TRUE(std::holds_alternative<Field>(p.message));
  EXPECT_EQ(std::get<Field>(p.message).force_steps.values, (std::vector<int32_t>{0, 0, 0, 0, 0, 0, 5, 0, -7, 0, 0, 0}));
}

TEST(ClientMessages, WhatIsNoMessageIsCounted) {
  const Payload no_messages[] = {
      {0x0A, 0x05, 0x08},                                                        // a stamp that is cut off
      {0x10},                                                                    // a number that is missing
      {0x12, 0x01, 0x01},                                                        // force_x of another wire type
      {0x00, 0x01},                                                              // field number 0
      {0x13},                                                                    // a group
      {0x42, 0x05, 1, 1, 1, 1, 1},                                               // five validities
      {0x10, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x01},  // a varint of eleven bytes
  };
  for (const Payload& payload : no_messages) {
    EXPECT_TRUE(std::holds_alternative<std::monostate>(packet(4, payload).message));
  }
  Payload contacts;
  for (int i = 0; i < 65; ++i) contacts.insert(contacts.end(), {0x12, 0x00});
  EXPECT_TRUE(std::holds_alternative<std::monostate>(packet(7, contacts).message));
  // Sizes that no sensor has reserve nothing.
  EXPECT_TRUE(std::holds_alternative<std::monostate>(packet(6, depth_of(0, 1U << 31, 1U << 31, 4, {})).message));
  EXPECT_TRUE(std::holds_alternative<std::monostate>(packet(6, depth_of(0, 1U << 11, 1U << 11, 2, {})).message));
}

TEST(ClientMessages, WhoIsThere) {
  // serial "0001", session 9, one sensor: id 1, board "b", 3 x 2 nodes from (-1000, 2000) um in steps of 1 and 2 mm,
  // calibrated
  Payload sensor = {0x08, 1, 0x12, 1, 'b', 0x30, 3, 0x38, 2};
  const auto put = [&](uint8_t tag, int64_t v) {
    sensor.push_back(tag);
    put_varint(sensor, static_cast<uint64_t>(v));
  };
  put(0x40, -1'000'000);
  put(0x48, 2'000'000);
  put(0x50, 1'000'000);
  put(0x58, 2'000'000);
  const Payload calibration = {0x7A, 2, 0x08, 1};
  sensor.insert(sensor.end(), calibration.begin(), calibration.end());
  Payload hello = {0x22, 4, '0', '0', '0', '1', 0x30, 9, 0x2A};
  put_varint(hello, sensor.size());
  hello.insert(hello.end(), sensor.begin(), sensor.end());
  const Packet p = packet(1, hello);
  const auto& h = std::get<Hello>(p.message);
  EXPECT_EQ(h.device_serial, "0001");
  EXPECT_EQ(h.session_id, 9U);
  ASSERT_EQ(h.sensors.size(), 1U);
  EXPECT_TRUE(h.sensors[0].is_calibrated);
  const auto at = h.sensors[0].position_m_at(4);  // second of the second row
  EXPECT_DOUBLE_EQ(at[0], 0.0);
  EXPECT_DOUBLE_EQ(at[1], 4e-3);
}

TEST(ClientMessages, StatusEventReplyAndTime) {
  const Packet status =
      packet(3, {0x10, 0xB0, 0xEA, 0x01, 0x2A, 4, 0x08, 2, 0x18, 1, 0x42, 6, 0x0A, 1, 'g', 0x10, 0xA0, 0x06, 0x48, 4});
  const auto& s = std::get<Status>(status.message);
  EXPECT_DOUBLE_EQ(s.frame_rate_hz, 30.0);
  EXPECT_EQ(s.replaced_frames, 2U);
  EXPECT_EQ(s.invalid_frames, 1U);
  EXPECT_EQ(s.health, 4U);
  ASSERT_EQ(s.temperatures_c.size(), 1U);
  EXPECT_DOUBLE_EQ(s.temperatures_c[0].second, 0.4);
  EXPECT_EQ(std::get<Event>(packet(10, {0x10, 2, 0x1A, 1, 'x'}).message).what, "x");
  EXPECT_EQ(std::get<Reply>(packet(12, {0x08, 7, 0x10, 4}).message).code, 4U);
  EXPECT_EQ(std::get<Time>(packet(14, {0x08, 7, 0x10, 4, 0x18, 5}).message).sent_us, 5U);
}

}  // namespace
}  // namespace ruffini::client
