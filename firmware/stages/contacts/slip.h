// Stick and slip of every node, and how close each contact is to sliding. Not in the papers.
//
// Two independent indicators, evaluated in every frame:
//   kinematic  Sticking nodes move with the indenter as one body. Its motion is that of the contact's centre, which
//              slips last: least squares over the nodes held since the last frame, with weight depth^4 (steps to the
//              rim). A node more than kSlackUm off that motion slips, and its anchor is dragged along (a friction
//              slider).
//   static     Coulomb friction: if everything slips, shear over pressure is uniform. evenness = that ratio in the
//              core over that at the rim: about 0.4 under a sticking ball, 1 under a sliding one.
// Friction mu is the rim's ratio when both indicators first agree that slip has begun (nodes slipping >= 35 %, evenness
// >= 0.6); it follows increases, and equals the contact's own |F_t| / F_n once that is even (0.88). Then |F_t| / (mu
// F_n) determines the state, and Mindlin's law 1 - (1 - |F_t| / (mu F_n))^(2/3) the slipping share. Nodes store
// friction and state, so contacts need no identity. Before friction is known, only the share of slipping nodes is
// available, and no margin. Limits: translation only, so pure twist appears in the nodes but not in the state; a
// rolling ball does not slip.
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
  static constexpr int64_t kSlackUm = 15;  // three standard deviations of a marker's position

  SlipTracker(const NodeGrid& grid, int64_t force_lsb_un);

  // `component`: from ContactFinder, the number of the contact that each node belongs to.
  void track(const ContactList& contacts, std::span<const uint16_t> component, std::span<const NodeForce> force,
             std::span<const NodeDisplacement> displacement);
  // Resets the history: the next frame is the first one.
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
    Place anchor;          // position of the node if it had stuck, 1/8 um
    int64_t friction = 0;  // Q16
    uint8_t phase = 0;     // SlipState, and a bit if it has slid
    bool is_held = false;  // pressed in the previous frame
  };
  // Motion of the indenter since the previous frame, 1/8 um, and its rotation, Q20 of that per um, about a point in um.
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
  std::vector<uint8_t> depth_;  // steps to the rim, where it is 1; 0: not pressed
  std::vector<int32_t> pressed_;
  std::array<size_t, ContactList::kMax + 1> begin_{};  // index of each contact's first node in pressed_
  std::array<ContactSlip, ContactList::kMax> contacts_{};
};

}  // namespace ruffini
