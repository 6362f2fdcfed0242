#include <algorithm>
#include <array>
#include <limits>

#include "link/contact_parts.h"

namespace ruffini {
namespace {

int32_t as_32(int64_t v) {
  return static_cast<int32_t>(
      std::clamp<int64_t>(v, std::numeric_limits<int32_t>::min(), std::numeric_limits<int32_t>::max()));
}

}  // namespace

void encode_tool(const FrameState& s, const BoardSettings& /*board*/, ruffini_Contacts& out) {
  const TipTouch& tip = s.tip;
  if (!tip.is_touched || out.contacts_count == 0) return;
  state_axes(s, out.contacts[0]);
  out.contacts[0].has_tool = true;
  ruffini_ToolTouch& tool = out.contacts[0].tool;
  tool.tool_um_count = tool.normal_force_un_count = 3;
  tool.tool_um[0] = as_32(tip.x_um);
  tool.tool_um[1] = as_32(tip.y_um);
  tool.tool_um[2] = as_32(tip.travel_um);
  tool.turn_urad_count = 2;
  tool.turn_urad[0] = as_32(tip.roll_urad);
  tool.turn_urad[1] = as_32(tip.pitch_urad);
  for (size_t i = 0; i < 3; ++i) tool.normal_force_un[i] = -(tip.force_un * tip.axis_1e6[i] / 1'000'000);
  tool.tool_sigma_count = 7;
  const std::array<int64_t, 7> sigma{tip.sigma[0], tip.sigma[2], tip.sigma[3],        tip.sigma[1],
                                     tip.sigma[4], tip.sigma[5], tip.sigma[6] / 1'000};
  std::transform(sigma.begin(), sigma.end(), tool.tool_sigma,
                 [](int64_t v) { return static_cast<uint32_t>(as_32(v)); });
  tool.flat_area_um2_k = static_cast<uint32_t>(tip.flat_area_um2 / 1'000);
  tool.flat_area_sigma_um2_k = static_cast<uint32_t>(tip.flat_area_sigma_um2 / 1'000);
}

}  // namespace ruffini
