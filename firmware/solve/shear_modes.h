// Low-dimensional basis of the shear that contacts usually carry, as a few vectors over each contact's nodes.
//
// With q the pressure of the current estimate, w the weight of a node and X, Y its position relative to the centre of
// q, each contact has twelve modes: the amplitudes q, w and q (X^2 + Y^2) times
//   (1, 0), (0, 1)   translation along x, y       (-Y, X)   twist       (X, Y)   spreading
// They are orthogonalized one after the other (modified Gram-Schmidt); modes with no remainder are dropped. They serve
// two purposes:
//   shrink       Shear of the linear estimate outside the modes is mostly noise. The remainder after projection
//                is multiplied by 1 - 1.5 E_noise / E_rest, not below 0 (James and Stein, 1961; E: sums of squares)
//   precondition z += 2 sum b (b . r) / (b . b): a prior that lets two steps reach the modes
// Contacts beyond kMaxContacts have no modes and keep their shear. All vectors have 16 bits and exact 64-bit sums.
// Frame thread; no allocation after the constructor. Not in the paper; measured in host/ruffini/fem/DESIGN.md.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/image_view.h"
#include "solve/components.h"

namespace ruffini {

// Position of a node relative to the pad's centre.
struct NodePlace {
  int32_t x_um = 0;
  int32_t y_um = 0;
};

class ShearModes {
 public:
  static constexpr int kMaxContacts = 8;
  static constexpr int kModes = 12;
  static constexpr int kGainShift = 1;         // the prior of the modes is twice that of a node with full weight
  static constexpr int64_t kNoiseShare = 192;  // 1.5 in Q7

  // noise_y: standard deviation of the linear estimate's shear, in the unit of y; at most 2^24.
  ShearModes(GridSize nodes, std::span<const NodePlace> places, int64_t noise_y);

  // Assigns the support's nodes to contacts. `index`: the unknowns of the support, x, y, z of each node in turn.
  void assign(std::span<const uint8_t> mask, std::span<const uint32_t> index);
  // Computes the modes of `y` (x, y, z of each support node) with `weight` (Q7, same order).
  void learn(std::span<const int64_t> y, std::span<const int64_t> weight);
  void shrink(std::span<int64_t> y, std::span<const int64_t> weight) const;
  // Adds to z. Returns r . (the added vector) in units of 2^(2 energy_shift).
  int64_t precondition(std::span<const int64_t> r, std::span<int64_t> z, int energy_shift) const;

 private:
  struct Contact {
    std::vector<uint32_t> node;  // indices into the support
    std::vector<int16_t> modes;  // n_modes x (x, y of each node)
    std::array<int64_t, kModes> norm{};
    int n_modes = 0;
  };
  // Amplitudes and positions of one contact's nodes.
  struct Shape {
    std::vector<int64_t> pressure;
    std::vector<int64_t> weight;
    std::vector<int64_t> bulge;
    std::vector<int64_t> x_um;
    std::vector<int64_t> y_um;
  };

  [[nodiscard]] bool measure(const Contact& contact, std::span<const int64_t> y, std::span<const int64_t> weight);
  void pattern(const Contact& contact, std::span<const int64_t> amplitude, int direction);
  void append(Contact& contact);
  void shrink(const Contact& contact, std::span<int64_t> y, std::span<const int64_t> weight) const;

  std::vector<NodePlace> places_;
  int64_t noise_y_;
  Components components_;
  std::vector<uint32_t> support_node_;  // node of each position in the support
  std::array<Contact, kMaxContacts> contacts_;
  int n_contacts_ = 0;
  Shape shape_;
  std::vector<int64_t> vector_;            // the vector being orthogonalized
  mutable std::vector<int64_t> residual_;  // shear remaining after projection on the modes
};

}  // namespace ruffini
