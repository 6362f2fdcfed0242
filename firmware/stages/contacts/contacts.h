// Lists the separate contacts of a frame: area, centre of pressure and force of each.
//
// Contacts are 8-connected components of the contact mask, largest area first (then by first node). Area counts the
// nodes of the mask that press (f_z < 0); the centre of pressure is sum(X f_z) / sum(f_z) over those. A component
// without pressing nodes is dropped: the mask comes from the linear solve, which the second pass may contradict. A
// contact reaches the border if it exceeds the threshold at a node next to the edge of the visible pad.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "core/results.h"
#include "estimators/wrench.h"
#include "image/displacement.h"
#include "solve/components.h"

namespace ruffini {

class ContactFinder {
 public:
  ContactFinder(const NodeGrid& grid, int64_t force_lsb_un, int64_t threshold_lsb);

  ContactList find(std::span<const uint8_t> mask, std::span<const NodeForce> force,
                   std::span<const NodeDisplacement> displacement);
  // For the last list: the number of each node's contact, from 1 in the order of first nodes; 0: none.
  [[nodiscard]] std::span<const uint16_t> component() const { return components_.label(); }

 private:
  struct Sums {
    Contact contact;  // of component 0 until the first node is added
    int64_t pressure = 0;
    int64_t pressure_x = 0;
    int64_t pressure_y = 0;
    int64_t deepest = 0;
  };

  void add(int node, uint16_t component, const NodeForce& f, int64_t depth);
  [[nodiscard]] Contact finish(const Sums& sums) const;

  NodeGrid grid_;
  int64_t force_lsb_un_;
  int64_t threshold_lsb_;
  Components components_;
  std::vector<Sums> sums_;
};

}  // namespace ruffini
