#include "link/contact_parts.h"

namespace ruffini {

void encode_slip(const FrameState& s, const BoardSettings& /*board*/, ruffini_Contacts& out) {
  // Stick and slip are derived from shear and pressure: they are not measured unless both are in newtons.
  if (s.force.xy != Validity::kValid || s.force.z != Validity::kValid) return;
  for (size_t i = 0; i < out.contacts_count; ++i) {
    const ContactSlip& slip = s.slip.contact[i];
    if (slip.state == SlipState::kUnknown) continue;
    out.contacts[i].has_slip = true;
    out.contacts[i].slip = {.slip_state = static_cast<ruffini_SlipState>(slip.state),
                            .shear_ratio_1e3 = static_cast<uint32_t>(slip.ratio_1e3),
                            .friction_1e3 = static_cast<uint32_t>(slip.friction_1e3),
                            .friction_sigma_1e3 = static_cast<uint32_t>(slip.friction_sigma_1e3),
                            .slip_share_1e3 = static_cast<uint32_t>(slip.share_1e3),
                            .slip_margin_un = slip.margin_un};
  }
}

}  // namespace ruffini
