#include <gtest/gtest.h>

#include <cstdint>

#include "link/messages.h"

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
                .sure_1e3 = 871,
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

TEST(TellModel, EveryNumberOfTheContactModelHasItsOwnFieldAndUnit) {
  ruffini_Contact said = ruffini_Contact_init_zero;
  said.area_um2_k = 55'000;  // of the contact itself: they stay
  said.peak_depth_nm = -1'203'000;
  MessageEncoder::tell_model(modelled(), false, said);
  EXPECT_EQ(said.validity, ruffini_Validity_VALIDITY_VALID) << "that of the normal force";
  EXPECT_EQ(said.kind, ruffini_ContactKind_CONTACT_KIND_HERTZIAN);
  EXPECT_EQ(said.kind_sure_1e3, 871U);
  EXPECT_EQ(said.gel_depth_um, 1'203U);
  EXPECT_EQ(said.press_depth_um, 1'711U);
  EXPECT_EQ(said.depth_sigma_um, 88U);
  EXPECT_EQ(said.depth_validity, ruffini_Validity_VALIDITY_INVALID);
  EXPECT_EQ(said.area_um2_k, 55'000U);
  EXPECT_EQ(said.peak_depth_nm, -1'203'000);
  EXPECT_EQ(said.effective_area_um2_k, 78'539U);
  EXPECT_EQ(said.stiffness_pa_um, -19) << "it may fall while a press goes on";
  EXPECT_EQ(said.shore_a_1e1, 455U);
  EXPECT_EQ(said.shore_a_sigma_1e1, 62U);
  EXPECT_EQ(said.hardness_validity, ruffini_Validity_VALIDITY_UNCALIBRATED);
  EXPECT_EQ(said.mean_flow_um, 37U);
  EXPECT_EQ(said.moment_by_flow_unmm, 5'000'000'000U);
  EXPECT_FALSE(said.has_helmholtz) << "the board has no such stage: absent is not zero";
}

TEST(TellModel, PartsOfTheFlowAreThereWithTheirStage) {
  ruffini_Contact said = ruffini_Contact_init_zero;
  MessageEncoder::tell_model(modelled(), true, said);
  ASSERT_TRUE(said.has_helmholtz);
  EXPECT_EQ(said.helmholtz.curl_free_nm, 21'500U);
  EXPECT_EQ(said.helmholtz.divergence_free_nm, 4'062U);
  EXPECT_EQ(said.helmholtz.twist_urad, -59'000);
}

TEST(TellModel, BeforeAPressIsToldNeitherKindNorHardnessStands) {
  FrameState s = modelled();
  s.modelled = {.is_touched = true, .gel_depth_um = 150};
  ruffini_Contact said = ruffini_Contact_init_zero;
  MessageEncoder::tell_model(s, false, said);
  EXPECT_EQ(said.kind, ruffini_ContactKind_CONTACT_KIND_NOT_TOLD);
  EXPECT_EQ(said.kind_sure_1e3, 0U);
  EXPECT_EQ(said.shore_a_1e1, 0U);
  EXPECT_EQ(said.hardness_validity, ruffini_Validity_VALIDITY_NOT_MEASURED);
  EXPECT_EQ(said.gel_depth_um, 150U);
}

}  // namespace
}  // namespace ruffini
