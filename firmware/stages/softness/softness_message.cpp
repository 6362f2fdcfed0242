#include "link/contact_parts.h"

namespace ruffini {

void encode_softness(const FrameState& state, const BoardSettings& /*board*/, ruffini_Contacts& out) {
  const Squeeze& s = state.softness.squeeze;
  out.has_softness = true;
  out.softness = {.validity = to_proto(state.softness.validity),
                  .squeeze = static_cast<uint32_t>(s.n_squeezes),
                  .n_frames = static_cast<uint32_t>(s.n_frames),
                  .modulus_pa = static_cast<uint32_t>(s.modulus_pa),
                  .low_pa = static_cast<uint32_t>(s.low_pa),
                  .high_pa = static_cast<uint32_t>(s.high_pa),
                  .log_share_q16 = static_cast<int32_t>(s.log_share_q16),
                  .log_sigma_q16 = static_cast<uint32_t>(s.log_sigma_q16)};
}

}  // namespace ruffini
