#include "link/contact_parts.h"

namespace ruffini {

void encode_helmholtz(const FrameState& s, const BoardSettings& /*board*/, ruffini_Contacts& out) {
  if (out.contacts_count == 0) return;
  out.contacts[0].has_helmholtz = true;
  out.contacts[0].helmholtz = {.curl_free_nm = static_cast<uint32_t>(1'000 * s.helmholtz.curl_free_q4 / 16),
                               .divergence_free_nm = static_cast<uint32_t>(1'000 * s.helmholtz.divergence_free_q4 / 16),
                               .twist_urad = static_cast<int32_t>(s.helmholtz.twist_urad)};
}

}  // namespace ruffini
