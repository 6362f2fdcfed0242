// Messages that stages add to CONTACTS, each encoded in the folder of its stage.
#pragma once

#include <span>

#include "board/settings.h"
#include "core/slots.h"
#include "ruffini.pb.h"

namespace ruffini {

// Used if the board's pipeline writes `slot`. `encode` adds its message for the contacts in `out`, in the order of slot
// kContacts.
struct ContactPart {
  Slot slot;
  void (*encode)(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
};

[[nodiscard]] std::span<const ContactPart> contact_parts();

// Each in stages/<name>/<name>_message.cpp.
void encode_slip(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
void encode_skin(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
void encode_contact_model(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
void encode_helmholtz(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
void encode_tool(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);
void encode_softness(const FrameState& state, const BoardSettings& board, ruffini_Contacts& out);

[[nodiscard]] constexpr ruffini_Validity to_proto(Validity v) { return static_cast<ruffini_Validity>(v); }

// For surfaces that measure force along their normal apart from that along them.
inline void state_axes(const FrameState& s, ruffini_Contact& contact) {
  contact.force_validity_count = 3;
  contact.force_validity[0] = contact.force_validity[1] = to_proto(s.force.xy);
  contact.force_validity[2] = to_proto(s.force.z);
}

}  // namespace ruffini
