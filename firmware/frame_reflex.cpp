#include "frame_reflex.h"

#include <algorithm>
#include <array>

namespace ruffini {
namespace {

constexpr int64_t kMaxForceUn = 2'000'000'000;  // the sum of three squares fits 64 bits

}  // namespace

bool Reflex::update(const FrameState& state) {
  const std::array<int64_t, 3> force = {state.wrench.sum.force_x_un, state.wrench.sum.force_y_un,
                                        state.wrench.sum.force_z_un};
  int64_t square = 0;
  bool is_known = false;
  for (size_t i = 0; i < force.size(); ++i) {
    if (state.wrench.validity[i] == Validity::kInvalid) {
      is_known = false;
      break;
    }
    if (state.wrench.validity[i] != Validity::kValid) continue;
    is_known = true;
    const int64_t f = std::clamp(force[i], -kMaxForceUn, kMaxForceUn);
    square += f * f / 4;  // a quarter, because three full squares exceed 63 bits
  }
  if (!is_known) {
    if (settings_.when_invalid != WhenInvalid::kHold) is_on_ = settings_.when_invalid == WhenInvalid::kOn;
    return is_on_;
  }
  const int64_t limit = is_on_ ? settings_.force_un * 7 / 8 : settings_.force_un;
  is_on_ = (settings_.force_un != 0 && square > limit * limit / 4) || slips(state);
  return is_on_;
}

bool Reflex::slips(const FrameState& state) const {
  if (settings_.slip == ReflexSlip::kNone) return false;
  if (state.force.xy != Validity::kValid || state.force.z != Validity::kValid) return false;
  const SlipState least = settings_.slip == ReflexSlip::kSlides ? SlipState::kSlides : SlipState::kIncipient;
  const auto end = state.slip.contact.begin() + state.contacts.n_listed;
  return std::any_of(state.slip.contact.begin(), end, [&](const ContactSlip& c) { return c.state >= least; });
}

}  // namespace ruffini
