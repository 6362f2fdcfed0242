#include "estimators/contacts.h"

#include <algorithm>

namespace ruffini {

ContactFinder::ContactFinder(const NodeGrid& grid, int64_t force_lsb_un)
    : grid_(grid),
      force_lsb_un_(force_lsb_un),
      component_(static_cast<size_t>(grid.size().count())),
      stack_(static_cast<size_t>(grid.size().count())) {}

Contact ContactFinder::grow(int seed, uint16_t number, std::span<const uint8_t> mask, std::span<const NodeForce> force,
                            std::span<const NodeDisplacement> displacement) {
  const GridSize n = grid_.size();
  Contact contact{.first_node = seed, .component = number};
  int64_t pressure = 0;
  int64_t pressure_x = 0;
  int64_t pressure_y = 0;
  int64_t deepest = 0;
  size_t n_waiting = 0;
  stack_[n_waiting++] = seed;
  component_[static_cast<size_t>(seed)] = number;
  while (n_waiting > 0) {
    const int node = stack_[--n_waiting];
    const int x = node % n.n_x;
    const int y = node / n.n_x;
    const NodeForce& f = force[static_cast<size_t>(node)];
    contact.force_x_un += f.x * force_lsb_un_;
    contact.force_y_un += f.y * force_lsb_un_;
    contact.force_z_un += f.z * force_lsb_un_;
    deepest = std::min<int64_t>(deepest, displacement[static_cast<size_t>(node)].z.raw());
    if (f.z < 0) {
      ++contact.n_nodes;
      pressure += f.z;
      pressure_x += grid_.twice_steps_x(x) * f.z;
      pressure_y += grid_.twice_steps_y(y) * f.z;
    }
    for (int v = std::max(y - 1, 0); v <= std::min(y + 1, n.n_y - 1); ++v) {
      for (int u = std::max(x - 1, 0); u <= std::min(x + 1, n.n_x - 1); ++u) {
        const auto at = static_cast<size_t>(v * n.n_x + u);
        if (mask[at] == 0 || component_[at] != 0) continue;
        component_[at] = number;
        stack_[n_waiting++] = static_cast<int32_t>(at);
      }
    }
  }
  contact.area_um2 = contact.n_nodes * grid_.node_area_um2();
  contact.peak_depth_nm = deepest * kDisplacementLsbNm;
  if (pressure < 0) {
    contact.center_x_um = floor_div(-grid_.to_um_x(pressure_x), -pressure);
    contact.center_y_um = floor_div(-grid_.to_um_y(pressure_y), -pressure);
  }
  return contact;
}

ContactList ContactFinder::find(std::span<const uint8_t> mask, std::span<const NodeForce> force,
                                std::span<const NodeDisplacement> displacement) {
  ContactList list;
  std::fill(component_.begin(), component_.end(), uint16_t{0});
  for (int seed = 0; seed < grid_.size().count(); ++seed) {
    if (mask[static_cast<size_t>(seed)] == 0 || component_[static_cast<size_t>(seed)] != 0) continue;
    const Contact contact = grow(seed, static_cast<uint16_t>(++list.n_found), mask, force, displacement);
    const auto end = list.contacts.begin() + list.n_listed;
    const auto place =
        std::find_if(list.contacts.begin(), end, [&](const Contact& c) { return c.area_um2 < contact.area_um2; });
    if (place == list.contacts.end()) continue;
    list.n_listed = std::min(list.n_listed + 1, ContactList::kMax);
    std::move_backward(place, list.contacts.begin() + list.n_listed - 1, list.contacts.begin() + list.n_listed);
    *place = contact;
  }
  return list;
}

}  // namespace ruffini
