#include "estimators/wrench_covariance.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <utility>

#include "base/filled.h"
#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

constexpr PadSettings kPad{.size_x_um = 20'000, .size_y_um = 16'000};

// 2 and 7 mN, 8 and 3 N um, 20 and 5 um, no common factor unless given.
std::vector<int32_t> parameters(int32_t shear_q20 = 0, int32_t pressure_q20 = 0) {
  return {2'000, 7'000, 8'000, 3'000, 20'000, 5'000, shear_q20, pressure_q20};
}

Result<WrenchErrorModel> load(const std::vector<int32_t>& values, int64_t stiffness_q20 = 0,
                              const std::vector<int32_t>& crosstalk_q20 = {}) {
  test::CalibrationBytes file;
  file.meta("kinds", "support").tensor("support.error_wrench", "I32", {4, 2}, values);
  if (!crosstalk_q20.empty()) file.tensor("support.error_crosstalk", "I32", {1}, crosstalk_q20);
  const std::vector<uint8_t> bytes = file.bytes();
  std::vector<uint64_t> storage((bytes.size() + 7) / 8);
  std::memcpy(storage.data(), bytes.data(), bytes.size());
  auto parsed = Calibration::parse({reinterpret_cast<const uint8_t*>(storage.data()), bytes.size()});
  EXPECT_TRUE(parsed.has_value());
  return WrenchErrorModel::load(parsed.value(), kPad, stiffness_q20);
}

// Place of (i, j), i <= j, in the upper triangle by rows.
int64_t at(const WrenchCovariance& c, size_t i, size_t j) { return c.upper[i * 6 - i * (i + 1) / 2 + j]; }

ContactList one_contact(int64_t x_um, int64_t y_um, int64_t force_z_un) {
  ContactList list;
  list.contacts[0] = {.center_x_um = x_um, .center_y_um = y_um, .force_z_un = force_z_un};
  list.n_listed = list.n_found = 1;
  return list;
}

TEST(WrenchCovariance, OfNothingIsTheErrorOfOneContactInTheMiddle) {
  const WrenchErrorModel model = load(parameters()).value();
  const WrenchCovariance none = model.run({}, {});
  EXPECT_EQ(none, model.run({}, one_contact(0, 0, 0)));
  EXPECT_EQ(at(none, 0, 0), 4'000'000);
  EXPECT_EQ(at(none, 2, 2), 49'000'000);
  EXPECT_EQ(at(none, 3, 3), 64'000'000);
  EXPECT_EQ(at(none, 5, 5), 9'000'000);
  EXPECT_EQ(at(none, 0, 5), 0);
}

TEST(WrenchCovariance, OfAContactIsCarriedToThePadsCentre) {
  const WrenchErrorModel model = load(parameters()).value();
  const WrenchCovariance c = model.run({}, one_contact(3'000, -2'000, -1'000'000));  // 1 N
  // Lever 20 um times 1 N: 20'000 uN mm. t = X x F: tx = y fz, ty = -x fz, tz = x fy - y fx.
  EXPECT_EQ(at(c, 3, 3), 64'000'000 + 400'000'000 + 4 * 49'000'000);
  EXPECT_EQ(at(c, 4, 4), 64'000'000 + 400'000'000 + 9 * 49'000'000);
  EXPECT_EQ(at(c, 5, 5), 9'000'000 + 25'000'000 + (4 + 9) * 4'000'000);
  EXPECT_EQ(at(c, 2, 3), -2 * 49'000'000);
  EXPECT_EQ(at(c, 2, 4), -3 * 49'000'000);
  EXPECT_EQ(at(c, 3, 4), 6 * 49'000'000);
  EXPECT_EQ(at(c, 0, 5), 2 * 4'000'000);
  EXPECT_EQ(at(c, 1, 5), 3 * 4'000'000);
}

TEST(WrenchCovariance, TheMaterialErrsForShearAndPressureAlike) {
  const WrenchErrorModel model = load(parameters(1 << 14, 1 << 15)).value();  // 1/64 and 1/32
  const Wrench wrench{.force_x_un = 640'000,
                      .force_y_un = -320'000,
                      .force_z_un = -3'200'000,
                      .torque_x_un_um = 6'400'000'000,
                      .torque_y_un_um = 0,
                      .torque_z_un_um = 1'280'000'000};
  const WrenchCovariance c = model.run(wrench, {});
  const WrenchCovariance rest = load(parameters()).value().run(wrench, {});
  EXPECT_EQ(at(c, 0, 0) - at(rest, 0, 0), 10'000LL * 10'000);
  EXPECT_EQ(at(c, 0, 1) - at(rest, 0, 1), -10'000LL * 5'000);
  EXPECT_EQ(at(c, 0, 5) - at(rest, 0, 5), 10'000LL * 20'000);
  EXPECT_EQ(at(c, 2, 2) - at(rest, 2, 2), 100'000LL * 100'000);
  EXPECT_EQ(at(c, 2, 3) - at(rest, 2, 3), -100'000LL * 200'000);
  EXPECT_EQ(at(c, 0, 2), 0);
}

TEST(WrenchCovariance, TheStiffnessErrsForTheWholeWrenchAtOnce) {
  const Wrench wrench{.force_x_un = 640'000, .force_z_un = -3'200'000, .torque_y_un_um = 6'400'000'000};
  const WrenchCovariance c = load(parameters(), 1 << 16).value().run(wrench, {});  // 1/16
  const WrenchCovariance rest = load(parameters()).value().run(wrench, {});
  EXPECT_EQ(at(c, 0, 0) - at(rest, 0, 0), 40'000LL * 40'000);
  EXPECT_EQ(at(c, 2, 2) - at(rest, 2, 2), 200'000LL * 200'000);
  EXPECT_EQ(at(c, 0, 2) - at(rest, 0, 2), -40'000LL * 200'000);
  EXPECT_EQ(at(c, 2, 4) - at(rest, 2, 4), -200'000LL * 400'000);
  EXPECT_EQ(at(c, 1, 1), at(rest, 1, 1));
}

TEST(WrenchCovariance, ContactsAddUpAndUnlistedOnesCount) {
  const WrenchErrorModel model = load(parameters()).value();
  ContactList two = one_contact(3'000, 0, 0);
  two.contacts[1] = {.center_x_um = -3'000};
  two.n_listed = two.n_found = 2;
  const WrenchCovariance c = model.run({}, two);
  EXPECT_EQ(at(c, 2, 2), 2 * 49'000'000);
  EXPECT_EQ(at(c, 2, 4), 0);
  two.n_found = 5;
  const WrenchCovariance more = model.run({}, two);
  EXPECT_EQ(at(more, 2, 2), 5 * 49'000'000);
  EXPECT_GT(at(more, 4, 4), at(c, 4, 4) + 3 * 100 * 49'000'000LL);  // half the pad is 10 mm
}

TEST(WrenchCovariance, AFilledForceErrsWhereItActs) {
  const WrenchErrorModel model = load(parameters()).value();
  const ContactList touch = one_contact(3'000, 0, -1'000'000);
  const WrenchCovariance whole = model.run({}, touch);
  // 0.64 N along x at y = 2 mm and 0.32 N along y at x = -3 mm, of which an eighth errs.
  const WrenchCovariance shear = model.run(
      {}, touch, {.x_un = 640'000, .y_un = 320'000, .y_of_x_un_um = 1'280'000'000, .x_of_y_un_um = -960'000'000});
  const auto more = [&](const WrenchCovariance& c, size_t i, size_t j) { return at(c, i, j) - at(whole, i, j); };
  EXPECT_EQ(more(shear, 0, 0), 80'000LL * 80'000);
  EXPECT_EQ(more(shear, 1, 1), 40'000LL * 40'000);
  EXPECT_EQ(more(shear, 0, 5), -80'000LL * 160'000);
  EXPECT_EQ(more(shear, 1, 5), -40'000LL * 120'000);
  EXPECT_EQ(more(shear, 0, 1), 0);
  for (const size_t pressure : {2U, 3U, 4U}) EXPECT_EQ(more(shear, pressure, pressure), 0);
  // 1.28 N of pressure at (3, -2) mm, of which 22 / 256 err.
  const WrenchCovariance pressed =
      model.run({}, touch, {.z_un = 1'280'000, .y_of_z_un_um = -2'560'000'000, .x_of_z_un_um = 3'840'000'000});
  EXPECT_EQ(more(pressed, 2, 2), 110'000LL * 110'000);
  EXPECT_EQ(more(pressed, 2, 3), -110'000LL * 220'000);
  EXPECT_EQ(more(pressed, 2, 4), -110'000LL * 330'000);
  for (const size_t of_shear : {0U, 1U, 5U}) EXPECT_EQ(more(pressed, of_shear, of_shear), 0);
}

TEST(WrenchCovariance, SumsTheForcesOfFilledNodesWhereTheyAct) {
  BoardSettings board;
  board.pad = kPad;
  board.grid = {3, 3};  // nodes 10 mm and 8 mm apart
  board.window = {.min_x_um = 0, .min_y_um = 0, .max_x_um = 20'000, .max_y_um = 16'000};
  std::vector<NodeForce> force(9);
  force[0] = {-3, 5, -100};
  force[2] = {7, -11, 200};
  force[4] = {1'000, 1'000, 1'000};
  std::vector<uint8_t> filled(9);
  filled[0] = kShearFilled;
  filled[2] = kAllFilled;
  const FilledForce sum = sum_filled(NodeGrid(board), force, filled, 10);
  EXPECT_EQ(sum.x_un, 100);
  EXPECT_EQ(sum.y_un, 160);
  EXPECT_EQ(sum.z_un, 2'000);
  EXPECT_EQ(sum.y_of_x_un_um, -8'000 * 100);
  EXPECT_EQ(sum.x_of_y_un_um, -10'000 * 50 + 10'000 * 110);
  EXPECT_EQ(sum.y_of_z_un_um, -8'000 * 2'000);
  EXPECT_EQ(sum.x_of_z_un_um, 10'000 * 2'000);
}

TEST(WrenchCovariance, ShearErrsWithWhatPresses) {
  const ContactList touch = one_contact(3'000, -2'000, -1'024'000);
  const WrenchCovariance without = load(parameters()).value().run({}, touch);
  const WrenchCovariance c = load(parameters(), 0, {1 << 12}).value().run({}, touch);  // 1/256: 4 mN
  EXPECT_EQ(at(c, 0, 0) - at(without, 0, 0), 4'000LL * 4'000);
  EXPECT_EQ(at(c, 1, 1) - at(without, 1, 1), 4'000LL * 4'000);
  EXPECT_EQ(at(c, 5, 5) - at(without, 5, 5), 8'000LL * 8'000 + 12'000LL * 12'000);
  EXPECT_EQ(at(c, 2, 2), at(without, 2, 2));
  EXPECT_FALSE(load(parameters(), 0, {-1}));
  EXPECT_FALSE(load(parameters(), 0, {(1 << 20) + 1}));
}

TEST(WrenchCovariance, LargestNumbersDoNotOverflow) {
  const WrenchErrorModel model =
      load({1 << 20, 1 << 20, 1 << 24, 1 << 24, 1 << 20, 1 << 20, 1 << 20, 1 << 20}, 1 << 19, {1 << 20}).value();
  constexpr int64_t kFar = int64_t{1} << 60;
  const Wrench wrench{kFar, -kFar, kFar, -kFar, kFar, kFar};
  ContactList list;
  for (Contact& contact : list.contacts) contact = {.center_x_um = kFar, .center_y_um = -kFar, .force_z_un = -kFar};
  list.n_listed = ContactList::kMax;
  list.n_found = 100'000;
  const WrenchCovariance c = model.run(wrench, list, {kFar, kFar, kFar, -kFar, kFar, -kFar, kFar});
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_GT(at(c, i, i), 0) << i;
    for (size_t j = i + 1; j < 6; ++j) {
      EXPECT_LE(static_cast<__int128>(at(c, i, j)) * at(c, i, j), static_cast<__int128>(at(c, i, i)) * at(c, j, j));
    }
  }
}

TEST(WrenchCovariance, RefusesParametersThatStateNoError) {
  std::vector<int32_t> none = parameters();
  none[1] = 0;
  EXPECT_FALSE(load(none));
  std::vector<int32_t> vast = parameters();
  vast[7] = (1 << 20) + 1;
  EXPECT_FALSE(load(vast));
  EXPECT_TRUE(load(parameters()));
}

}  // namespace
}  // namespace ruffini
