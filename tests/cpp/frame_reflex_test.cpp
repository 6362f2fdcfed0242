#include "frame_reflex.h"

#include <gtest/gtest.h>

#include <tuple>

namespace ruffini {
namespace {

FrameState pressed(int64_t x_un, int64_t y_un, int64_t z_un, Validity validity = Validity::kValid) {
  FrameState state;
  state.wrench.sum = {.force_x_un = x_un, .force_y_un = y_un, .force_z_un = z_un};
  state.wrench.validity.fill(validity);
  state.force.xy = state.force.z = validity;
  return state;
}

FrameState sliding(SlipState slip) {
  FrameState state = pressed(0, 0, -1);
  state.contacts.n_listed = 2;
  state.slip.contact[1].state = slip;
  return state;
}

TEST(Reflex, IsOnAboveTheLimitInTheSameFrameAndOffBelowSevenEighths) {
  Reflex reflex({.chip = "c", .line = "l", .force_un = 1'000'000});
  EXPECT_FALSE(reflex.update(pressed(0, 0, -1'000'000)));
  EXPECT_TRUE(reflex.update(pressed(0, 0, -1'000'010)));
  EXPECT_TRUE(reflex.update(pressed(0, 0, -875'010)));
  EXPECT_FALSE(reflex.update(pressed(0, 0, -875'000)));
  EXPECT_FALSE(reflex.update(pressed(0, 0, -900'000)));
  EXPECT_TRUE(reflex.update(pressed(600'000, -600'000, -600'000))) << "1.04 N in all";
  EXPECT_TRUE(reflex.update(pressed(INT64_MIN / 4, INT64_MAX / 4, INT64_MAX / 4)));
}

TEST(Reflex, ForcesThatAreNotMeasuredDoNotCount) {
  Reflex reflex({.chip = "c", .line = "l", .force_un = 1'000'000});
  FrameState state = pressed(5'000'000, 0, -10);
  state.wrench.validity[0] = Validity::kNotMeasured;
  EXPECT_FALSE(reflex.update(state));
}

TEST(Reflex, AnInvalidFrameHoldsOrSwitchesAsTheBoardWants) {
  for (const auto& [when, while_off, while_on] :
       {std::tuple{WhenInvalid::kHold, false, true}, std::tuple{WhenInvalid::kOn, true, true},
        std::tuple{WhenInvalid::kOff, false, false}}) {
    for (const Validity wrong : {Validity::kInvalid, Validity::kNotMeasured, Validity::kUncalibrated}) {
      Reflex reflex({.chip = "c", .line = "l", .force_un = 1'000'000, .when_invalid = when});
      EXPECT_EQ(reflex.update(pressed(0, 0, -5'000'000, wrong)), while_off);
      EXPECT_TRUE(reflex.update(pressed(0, 0, -5'000'000)));
      EXPECT_EQ(reflex.update(pressed(0, 0, 0, wrong)), while_on);
    }
  }
  Reflex reflex({.chip = "c", .line = "l", .force_un = 1'000'000, .when_invalid = WhenInvalid::kOn});
  FrameState half = pressed(0, 0, 0);
  half.wrench.validity[2] = Validity::kInvalid;
  EXPECT_TRUE(reflex.update(half)) << "one component that is wrong makes the force unknown";
}

TEST(Reflex, SlipSwitchesAtTheStateThatTheBoardNames) {
  Reflex incipient({.chip = "c", .line = "l", .slip = ReflexSlip::kIncipient});
  EXPECT_FALSE(incipient.update(sliding(SlipState::kSticks)));
  EXPECT_TRUE(incipient.update(sliding(SlipState::kIncipient)));
  EXPECT_TRUE(incipient.update(sliding(SlipState::kSlides)));
  EXPECT_FALSE(incipient.update(sliding(SlipState::kUnknown)));
  EXPECT_FALSE(incipient.update(pressed(0, 0, -5'000'000))) << "a board that names no force";
  Reflex slides({.chip = "c", .line = "l", .slip = ReflexSlip::kSlides});
  EXPECT_FALSE(slides.update(sliding(SlipState::kIncipient)));
  EXPECT_TRUE(slides.update(sliding(SlipState::kSlides)));
  Reflex by_force({.chip = "c", .line = "l", .force_un = 1'000'000});
  EXPECT_FALSE(by_force.update(sliding(SlipState::kSlides)));
}

}  // namespace
}  // namespace ruffini
