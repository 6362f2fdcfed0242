#include "link/contact_parts.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

namespace ruffini {
namespace {

// Every number differs from every other, so that none can stand in another's field.
FrameState modelled() {
  FrameState s;
  s.wrench.validity.fill(Validity::kNotMeasured);
  s.wrench.validity[2] = Validity::kValid;
  s.modelled = {.is_touched = true,
                .has_hardness = true,
                .kind = ContactKind::kHertzian,
                .confidence_1e3 = 871,
                .gel_depth_um = 1'203,
                .press_depth_um = 1'711,
                .depth_sigma_um = 88,
                .area_um2 = 55'000'000,
                .effective_area_um2 = 78'539'816,
                .stiffness_pa_um = -19,
                .shore_q4 = 45 * 16 + 8,
                .shore_sigma_q4 = 6 * 16 + 4,
                .mean_flow_um = 37,
                .moment_by_flow_unmm = 5'000'000'000,
                .depth_validity = Validity::kInvalid,
                .hardness_validity = Validity::kUncalibrated};
  s.helmholtz = {.curl_free_q4 = 16 * 21 + 8, .divergence_free_q4 = 16 * 4 + 1, .twist_urad = -59'000};
  return s;
}

ruffini_Contacts one_contact() {
  ruffini_Contacts out = ruffini_Contacts_init_zero;
  out.contacts_count = 1;
  return out;
}

TEST(ContactParts, AStageThatReportsNothingOfThisFrameAddsNothing) {
  ruffini_Contacts none = ruffini_Contacts_init_zero;
  for (const ContactPart& part : contact_parts()) part.encode(modelled(), BoardSettings{}, none);
  EXPECT_EQ(none.contacts_count, 0);
  EXPECT_FALSE(none.contacts[0].has_model);
  ruffini_Contacts untouched = one_contact();
  encode_tool(FrameState{}, BoardSettings{}, untouched);
  encode_slip(FrameState{}, BoardSettings{}, untouched);
  EXPECT_FALSE(untouched.contacts[0].has_tool);
  EXPECT_FALSE(untouched.contacts[0].has_slip) << "absent, not zero";
}

TEST(ContactParts, ASqueezeIsSentWithoutAContact) {
  FrameState s;
  s.softness = {.squeeze = {.n_squeezes = 3,
                            .n_frames = 7,
                            .log_share_q16 = -140'000,
                            .log_sigma_q16 = 9'900,
                            .modulus_pa = 57'000,
                            .low_pa = 49'000,
                            .high_pa = 66'000},
                .validity = Validity::kInvalid};
  ruffini_Contacts sent = ruffini_Contacts_init_zero;
  encode_softness(s, BoardSettings{}, sent);
  ASSERT_TRUE(sent.has_softness);
  EXPECT_EQ(sent.softness.validity, ruffini_Validity_VALIDITY_INVALID);
  EXPECT_EQ(sent.softness.squeeze, 3U);
  EXPECT_EQ(sent.softness.n_frames, 7U);
  EXPECT_EQ(sent.softness.modulus_pa, 57'000U);
  EXPECT_EQ(sent.softness.low_pa, 49'000U);
  EXPECT_EQ(sent.softness.high_pa, 66'000U);
  EXPECT_EQ(sent.softness.log_share_q16, -140'000);
  EXPECT_EQ(sent.softness.log_sigma_q16, 9'900U);
}

TEST(ContactParts, EveryNumberOfTheContactModelHasItsOwnFieldAndUnit) {
  ruffini_Contacts sent = one_contact();
  sent.contacts[0].area_um2_k = 55'000;  // of the contact itself: they stay
  sent.contacts[0].peak_depth_nm = -1'203'000;
  encode_contact_model(modelled(), BoardSettings{}, sent);
  const ruffini_Contact& contact = sent.contacts[0];
  ASSERT_TRUE(contact.has_model);
  const ruffini_ContactModel& said = contact.model;
  EXPECT_EQ(contact.validity, ruffini_Validity_VALIDITY_VALID) << "that of the normal force";
  EXPECT_EQ(said.kind, ruffini_ContactKind_CONTACT_KIND_HERTZIAN);
  EXPECT_EQ(said.kind_sure_1e3, 871U);
  EXPECT_EQ(said.gel_depth_um, 1'203U);
  EXPECT_EQ(said.press_depth_um, 1'711U);
  EXPECT_EQ(said.depth_sigma_um, 88U);
  EXPECT_EQ(said.depth_validity, ruffini_Validity_VALIDITY_INVALID);
  EXPECT_EQ(contact.area_um2_k, 55'000U);
  EXPECT_EQ(contact.peak_depth_nm, -1'203'000);
  EXPECT_EQ(said.effective_area_um2_k, 78'539U);
  EXPECT_EQ(said.stiffness_pa_um, -19) << "it may fall while a press goes on";
  EXPECT_EQ(said.shore_a_1e1, 455U);
  EXPECT_EQ(said.shore_a_sigma_1e1, 62U);
  EXPECT_EQ(said.hardness_validity, ruffini_Validity_VALIDITY_UNCALIBRATED);
  EXPECT_EQ(said.mean_flow_um, 37U);
  EXPECT_EQ(said.moment_by_flow_unmm, 5'000'000'000U);
  EXPECT_FALSE(contact.has_helmholtz) << "the board has no such stage: absent is not zero";
}

TEST(ContactParts, PartsOfTheFlowAreThereWithTheirStage) {
  ruffini_Contacts sent = one_contact();
  encode_helmholtz(modelled(), BoardSettings{}, sent);
  const ruffini_Contact& said = sent.contacts[0];
  ASSERT_TRUE(said.has_helmholtz);
  EXPECT_EQ(said.helmholtz.curl_free_nm, 21'500U);
  EXPECT_EQ(said.helmholtz.divergence_free_nm, 4'062U);
  EXPECT_EQ(said.helmholtz.twist_urad, -59'000);
}

TEST(ContactParts, BeforeAPressIsToldNeitherKindNorHardnessStands) {
  FrameState s = modelled();
  s.modelled = {.is_touched = true, .gel_depth_um = 150};
  ruffini_Contacts sent = one_contact();
  encode_contact_model(s, BoardSettings{}, sent);
  const ruffini_ContactModel& said = sent.contacts[0].model;
  EXPECT_EQ(said.kind, ruffini_ContactKind_CONTACT_KIND_NOT_TOLD);
  EXPECT_EQ(said.kind_sure_1e3, 0U);
  EXPECT_EQ(said.shore_a_1e1, 0U);
  EXPECT_EQ(said.hardness_validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_EQ(said.gel_depth_um, 150U);
}

TEST(ContactParts, AToolsPlaceTurnAndHowSureTheyAreHaveTheirOwnFields) {
  FrameState s;
  s.tip = {.is_touched = true,
           .force_un = 400'000,
           .travel_um = 310,
           .x_um = -1'200,
           .y_um = 700,
           .roll_urad = -52'000,
           .pitch_urad = 174'533,
           .area_um2 = 28'000'000,
           .flat_area_um2 = 51'234'000,
           .flat_area_sigma_um2 = 2'345'999,
           .sigma = {9'000, 11, 120, 130, 4'000, 5'000, 640'000},
           .axis_1e6 = {0, -600'000, 800'000}};
  s.force = {.xy = Validity::kNotMeasured, .z = Validity::kValid};
  ruffini_Contacts sent = one_contact();
  encode_tool(s, BoardSettings{}, sent);
  ASSERT_EQ(sent.contacts[0].force_validity_count, 3);
  EXPECT_EQ(sent.contacts[0].force_validity[0], ruffini_Validity_VALIDITY_NOT_MEASURED) << "no force along the dome";
  EXPECT_EQ(sent.contacts[0].force_validity[1], ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_EQ(sent.contacts[0].force_validity[2], ruffini_Validity_VALIDITY_VALID);
  ASSERT_TRUE(sent.contacts[0].has_tool);
  const ruffini_ToolTouch& said = sent.contacts[0].tool;
  EXPECT_EQ(said.flat_area_um2_k, 51'234u);
  EXPECT_EQ(said.flat_area_sigma_um2_k, 2'345u);
  ASSERT_EQ(said.normal_force_un_count, 3);
  EXPECT_EQ(said.normal_force_un[1], 240'000) << "into the fingertip, against the tool's axis";
  EXPECT_EQ(said.normal_force_un[2], -320'000);
  ASSERT_EQ(said.tool_um_count, 3);
  EXPECT_EQ(said.tool_um[0], -1'200);
  EXPECT_EQ(said.tool_um[1], 700);
  EXPECT_EQ(said.tool_um[2], 310);
  ASSERT_EQ(said.turn_urad_count, 2);
  EXPECT_EQ(said.turn_urad[0], -52'000);
  EXPECT_EQ(said.turn_urad[1], 174'533);
  ASSERT_EQ(said.tool_sigma_count, 7);
  const std::vector<uint32_t> sigma(said.tool_sigma, said.tool_sigma + 7);
  EXPECT_EQ(sigma, (std::vector<uint32_t>{9'000, 120, 130, 11, 4'000, 5'000, 640})) << "way after X and Y; 1e-3 mm^2";
}

}  // namespace
}  // namespace ruffini
