// Averages the force field of a contact that does not change, over up to `frames` frames. Its force and moments are
// those of each frame, so a step appears at once; only the distribution over the contact's nodes is averaged.
//
//   b          what the displacement says of each touched unknown (`support.project` u): under white noise as
//              calibrated it has standard deviation one (solve/support_solver.h)
//   steady     |b - B| <= kLimit sqrt(1 + 1/n) at all nodes of the contact with history, and at least 3/4 have one
//   n          frames averaged: one more per steady frame, at most `frames`; 1 if the contact is not steady
//   B += (b - B) / n
//   g          f - m at nodes with history, minus the patterns below, so that it has neither force nor moment
//   m = f - (1 - 1/n) g, which is the force reported
//
// Patterns, q the pressure of this frame: for z q, q x, q y; for shear q (1, 0), q (0, 1), q (-y, x), x and y from
// the centre of pressure. What their amplitudes change is never averaged. The amplitudes are those of g's own force
// and moments, not a least-squares fit. Forces are kept to the step: what rounding leaves goes to the strongest node.
// Moments are kept but for rounding, unless all pressing nodes lie on a line. Contacts are those of the mask; beyond
// kMaxContacts none is averaged.
//
// With twice the calibrated noise, or half of it again shared by neighbours, next to nothing is averaged; with a fifth
// of it changes below the limit are averaged too: nodes of sliding contacts err by 3 % more (SIMULATED).
//
// Bounds, up to kMaxNodes nodes: |f - m| <= 2^20 (1/16 force step), else the contact is not steady; g is clamped to
// +-2^32; positions and pressures have 16 bits, so that each sum stays below 2^62. Frame thread; no allocation after
// the constructor. Reasons: host/ruffini/fem/DESIGN.md. Not in the paper.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "solve/components.h"
#include "solve/contact_mask.h"
#include "solve/shear_modes.h"

namespace ruffini {

class SteadyField {
 public:
  static constexpr int kMaxFrames = 32;
  static constexpr int kMaxContacts = 8;
  static constexpr size_t kMaxNodes = size_t{1} << 12;  // of a contact; a larger one is not averaged
  static constexpr int64_t kLimit = 4;                  // standard deviations

  // frames: 2 to kMaxFrames.
  SteadyField(GridSize nodes, std::span<const NodePlace> places, int frames);

  // `evidence`: b of x, y, z of each node of the mask, in node order, Q14 (SupportSolver::evidence()).
  void run(std::span<const uint8_t> mask, std::span<const int64_t> evidence, std::span<NodeForce> force,
           SaturationCounter& saturations);
  // Frames averaged at a node in the last run(); 0 outside contacts.
  [[nodiscard]] int frames_at(size_t node) const { return history_[node].n; }
  void forget();

 private:
  struct History {
    int n = 0;                          // 0: not touched before
    std::array<int64_t, 3> force{};     // m, 1/16 force step
    std::array<int64_t, 3> evidence{};  // B, Q14
  };
  // A node of the contact at hand.
  struct Touched {
    uint32_t node = 0;
    std::array<int64_t, 3> evidence{};  // b
    std::array<int64_t, 3> change{};    // g, 1/16 force step
    int64_t pressure = 0;               // q, 16 bits
    int64_t x = 0;                      // from the centre of pressure, 16 bits
    int64_t y = 0;
  };

  void gather(uint16_t contact, std::span<const uint16_t> label, std::span<const int64_t> evidence,
              std::span<const NodeForce> force);
  // Returns the frames that this one may be averaged with, 0 if the contact has changed or has no history.
  [[nodiscard]] int steady_frames() const;
  // Returns false if nothing presses.
  [[nodiscard]] bool place_patterns(std::span<const NodeForce> force);
  void take_out_shear();
  void take_out_pressure();
  void update(int n, std::span<NodeForce> force, SaturationCounter& saturations);

  std::vector<NodePlace> places_;
  int frames_;
  Components components_;
  std::vector<History> history_;
  std::vector<Touched> contact_;
};

}  // namespace ruffini
