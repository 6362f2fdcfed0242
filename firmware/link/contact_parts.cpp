#include "link/contact_parts.h"

#include <array>

namespace ruffini {
namespace {

constexpr std::array<ContactPart, 6> kTable = {{
    {Slot::kSlip, encode_slip},
    {Slot::kSkin, encode_skin},
    {Slot::kContactModel, encode_contact_model},
    {Slot::kHelmholtz, encode_helmholtz},
    {Slot::kToolTouch, encode_tool},
    {Slot::kSoftness, encode_softness},
}};

}  // namespace

std::span<const ContactPart> contact_parts() { return kTable; }

}  // namespace ruffini
