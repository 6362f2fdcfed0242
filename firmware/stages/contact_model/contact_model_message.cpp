#include "link/contact_parts.h"

namespace ruffini {

void encode_contact_model(const FrameState& s, const BoardSettings& /*board*/, ruffini_Contacts& out) {
  if (out.contacts_count == 0) return;
  const ModelledContact& c = s.modelled;
  out.contacts[0].validity = to_proto(s.wrench.validity[2]);
  out.contacts[0].has_model = true;
  out.contacts[0].model = {.depth_validity = to_proto(c.depth_validity),
                           .kind = static_cast<ruffini_ContactKind>(c.kind),
                           .kind_sure_1e3 = static_cast<uint32_t>(c.confidence_1e3),
                           .gel_depth_um = static_cast<uint32_t>(c.gel_depth_um),
                           .press_depth_um = static_cast<uint32_t>(c.press_depth_um),
                           .depth_sigma_um = static_cast<uint32_t>(c.depth_sigma_um),
                           .effective_area_um2_k = static_cast<uint32_t>(c.effective_area_um2 / 1'000),
                           .stiffness_pa_um = static_cast<int32_t>(c.stiffness_pa_um),
                           .shore_a_1e1 = static_cast<uint32_t>(10 * c.shore_q4 / 16),
                           .shore_a_sigma_1e1 = static_cast<uint32_t>(10 * c.shore_sigma_q4 / 16),
                           .hardness_validity = to_proto(c.hardness_validity),
                           .mean_flow_um = static_cast<uint32_t>(c.mean_flow_um),
                           .moment_by_flow_unmm = static_cast<uint64_t>(c.moment_by_flow_unmm)};
}

}  // namespace ruffini
