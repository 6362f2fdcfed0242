// Stick and slip: at every node, and how near each contact is to sliding. Not in the papers.
//
// Two independent signs, both of one frame after the other:
//   kinematic  Nodes that stick move with the indenter as one body. Its motion is that of the contact's middle, which
//              slips last: least squares over the nodes held since the last frame, weight depth^4 (steps to the rim).
//              A node more than kSlackUm off that motion slips; its place is then dragged along (a friction slider).
//   static     Coulomb: where all slips, shear over pressure is the same everywhere. evenness = that ratio in the
//              core over that at the rim: about 0.4 under a ball that sticks, 1 where it slides.
// Friction mu is the rim's ratio when both first agree that slip has begun (nodes slipping >= 35 %, evenness >= 0.6),
// follows it upwards, and is the contact's own |F_t| / F_n once that is even (0.88). Then |F_t| / (mu F_n) tells the
// state, and Mindlin's law 1 - (1 - |F_t| / (mu F_n))^(2/3) the share that slips. Nodes remember friction and
// state, so contacts need no identity. Before friction is known: share of slipping nodes, no margin.
// Translation only: a pure twist shows in the nodes, not in the state. A rolling ball does not slip.
//
// Frame thread; no allocation after the constructor; a few passes over the touched nodes.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/results.h"
#include "estimators/wrench.h"
#include "image/displacement.h"
#include "stages/contacts/contacts.h"

namespace ruffini {

class SlipTracker {
 public:
  static constexpr int64_t kSlackUm = 15;  // three standard deviations of a marker's place

  SlipTracker(const NodeGrid& grid, int64_t force_lsb_un);

  // `component` is the contact finder's: the number of the contact that each node belongs to.
  void track(const ContactList& contacts, std::span<const uint16_t> component, std::span<const NodeForce> force,
             std::span<const NodeDisplacement> displacement);
  // The next frame is the first one.
  void forget();

  [[nodiscard]] std::span<const NodeSlip> nodes() const { return state_; }
  // In the order of the contact list.
  [[nodiscard]] const std::array<ContactSlip, ContactList::kMax>& contacts() const { return contacts_; }

 private:
  struct Place {
    int64_t x = 0;
    int64_t y = 0;
  };
  struct Memory {
    Place anchor;          // where the node would be if it had stuck, 1/8 um
    int64_t friction = 0;  // Q16
    uint8_t phase = 0;     // SlipState, and whether it has slid
    bool is_held = false;  // pressed in the last frame
  };
  // The indenter's motion since the last frame, 1/8 um, and its turn, Q20 of that per um, about a place in um.
  struct Motion {
    Place about;
    Place go;
    int64_t turn = 0;
  };
  using Members = std::span<const int32_t>;  // pressed nodes of one contact

  void find_pressed(const ContactList& contacts, std::span<const uint16_t> component, std::span<const NodeForce> force);
  void find_depth();
  [[nodiscard]] int depth_from(int x, int y, int side) const;
  [[nodiscard]] Place moved(int32_t node, std::span<const NodeDisplacement> displacement) const;
  [[nodiscard]] int64_t weight(int32_t node) const;
  [[nodiscard]] Motion motion(Members members, std::span<const NodeDisplacement> displacement) const;
  [[nodiscard]] int follow(Members members, const Motion& motion, std::span<const NodeDisplacement> displacement);
  [[nodiscard]] ContactSlip judge(Members members, std::span<const NodeForce> force, int n_slipped);
  void mark(Members members, std::span<const NodeForce> force, SlipState state, int64_t friction);

  NodeGrid grid_;
  int64_t force_lsb_un_;
  std::vector<int32_t> x_um_;  // of each column
  std::vector<int32_t> y_um_;  // of each row
  std::vector<Memory> memory_;
  std::vector<NodeSlip> state_;
  std::vector<uint8_t> depth_;  // steps to the rim, which has 1; 0: not pressed
  std::vector<int32_t> pressed_;
  std::array<size_t, ContactList::kMax + 1> begin_{};  // of each contact's nodes in pressed_
  std::array<ContactSlip, ContactList::kMax> contacts_{};
};

}  // namespace ruffini
