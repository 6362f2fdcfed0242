#include <algorithm>
#include <array>

#include "link/contact_parts.h"
#include "stages/skin/skin_shape.h"

namespace ruffini {

void encode_skin(const FrameState& s, const BoardSettings& board, ruffini_Contacts& out) {
  for (size_t i = 0; i < out.contacts_count; ++i) {
    const SkinTouch& touch = s.skin.touches.touch[i];
    ruffini_Contact& contact = out.contacts[i];
    contact.id = touch.id;
    state_axes(s, contact);
    contact.has_skin = true;
    ruffini_SkinTouch& skin = contact.skin;
    skin.place_um_count = skin.normal_force_un_count = 3;
    const SkinPoint point = on_skin(board.skin, touch.x_um, touch.y_um);
    std::transform(point.place_um.begin(), point.place_um.end(), skin.place_um,
                   [](int64_t um) { return static_cast<int32_t>(um); });
    const std::array<int64_t, 3> force = pressing_vector_un(point, touch.press_un);
    std::copy(force.begin(), force.end(), skin.normal_force_un);
    skin.force_sigma_un = static_cast<uint64_t>(touch.press_sigma_un);
    skin.center_sigma_um = static_cast<uint32_t>(touch.place_sigma_um);
  }
}

}  // namespace ruffini
