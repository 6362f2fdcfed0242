#include "stages/contacts/contacts.h"

#include <algorithm>

namespace ruffini {

ContactFinder::ContactFinder(const NodeGrid& grid, int64_t force_lsb_un, int64_t threshold_lsb)
    : grid_(grid),
      force_lsb_un_(force_lsb_un),
      threshold_lsb_(threshold_lsb),
      components_(grid.size()),
      sums_(static_cast<size_t>(Components::max_count(grid.size()))) {}

void ContactFinder::add(int node, uint16_t component, const NodeForce& f, int64_t depth) {
  const int x = node % grid_.size().n_x;
  const int y = node / grid_.size().n_x;
  Sums& sums = sums_[component - size_t{1}];
  if (sums.contact.component == 0) sums.contact = {.first_node = node, .component = component};
  sums.contact.force_x_un += f.x * force_lsb_un_;
  sums.contact.force_y_un += f.y * force_lsb_un_;
  sums.contact.force_z_un += f.z * force_lsb_un_;
  sums.deepest = std::min(sums.deepest, depth);
  if (f.z < -threshold_lsb_ && grid_.is_window_border(x, y)) sums.contact.reaches_border = true;
  if (f.z >= 0) return;
  ++sums.contact.n_nodes;
  sums.pressure += f.z;
  sums.pressure_x += grid_.twice_steps_x(x) * f.z;
  sums.pressure_y += grid_.twice_steps_y(y) * f.z;
}

Contact ContactFinder::finish(const Sums& sums) const {
  Contact contact = sums.contact;
  contact.area_um2 = contact.n_nodes * grid_.node_area_um2();
  contact.peak_depth_nm = sums.deepest * kDisplacementLsbNm;
  if (sums.pressure < 0) {
    contact.center_x_um = floor_div(-grid_.to_um_x(sums.pressure_x), -sums.pressure);
    contact.center_y_um = floor_div(-grid_.to_um_y(sums.pressure_y), -sums.pressure);
  }
  return contact;
}

ContactList ContactFinder::find(std::span<const uint8_t> mask, std::span<const NodeForce> force,
                                std::span<const NodeDisplacement> displacement) {
  const std::span<const uint16_t> component = components_.find(mask);
  std::fill_n(sums_.begin(), components_.count(), Sums{});
  for (int node = 0; node < grid_.size().count(); ++node) {
    const auto i = static_cast<size_t>(node);
    if (component[i] != 0) add(node, component[i], force[i], displacement[i].z.raw());
  }
  ContactList list;
  for (int i = 0; i < components_.count(); ++i) {
    const Contact contact = finish(sums_[static_cast<size_t>(i)]);
    if (contact.n_nodes == 0) continue;
    ++list.n_found;
    list.reaches_border = list.reaches_border || contact.reaches_border;
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
