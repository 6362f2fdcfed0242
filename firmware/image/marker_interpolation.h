// Interpolates from markers to the observed nodes: sixteen markers and their weights for each node, computed when rest
// is learned.
//
//   lattice    Catmull-Rom along each axis, linear beyond the outermost markers (at most one pitch). A node's position
//              on the lattice, (a, b) in pitches, follows from the markers' measured rest positions, not the board's:
//              kPlaceRounds times  a += (X_node - X(a, b)) / pitch,  X(a, b) interpolated likewise
//   scattered  moving least squares (image/scattered_weights.h) over the nearest markers
//
// A node is filled if markers without a displacement of their own (lost or absent, filled from neighbours) have at
// least half of its weight: sum of their |weights| >= 1/2, where all weights sum to 1.
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

// Position relative to the pad's centre, 1/8 um.
struct PadPoint {
  int64_t x = 0;
  int64_t y = 0;
};

// Weights in Q28 with a sum of 1; unused ones are zero.
struct MarkerWeights {
  static constexpr size_t kCount = 16;
  std::array<int, kCount> marker{};
  std::array<int64_t, kCount> weight_q28{};
};

class MarkerInterpolation {
 public:
  explicit MarkerInterpolation(const BoardSettings& board);

  // `rest`: rest positions of the markers on the pad.
  void learn(std::span<const PadPoint> rest, std::span<const Marker> markers);

  // Returns the sums over the node's markers of weight value(marker), rounded to the unit of the values. values(marker)
  // returns three.
  template <typename Values>
  [[nodiscard]] std::array<int64_t, 3> three_at(size_t node, Values values) const {
    const MarkerWeights& weights = weights_[node];
    int64_t x = 0;
    int64_t y = 0;
    int64_t z = 0;
    for (size_t k = 0; k < MarkerWeights::kCount; ++k) {
      const std::array<int64_t, 3> value = values(static_cast<size_t>(weights.marker[k]));
      x += weights.weight_q28[k] * value[0];
      y += weights.weight_q28[k] * value[1];
      z += weights.weight_q28[k] * value[2];
    }
    return {round_shift(x, 28), round_shift(y, 28), round_shift(z, 28)};
  }
  // Sets kShearFilled for each filled node, else kNothingFilled. `is_missing`: nonzero for each marker without a
  // displacement of its own.
  void mark_filled(std::span<const uint8_t> is_missing, std::span<uint8_t> filled) const;

  [[nodiscard]] GridSize nodes() const { return nodes_; }
  [[nodiscard]] const PadPoint& place(size_t node) const { return place_[node]; }

 private:
  // Four lattice lines and their Q14 weights.
  struct Taps {
    std::array<int, 4> line{};
    std::array<int64_t, 4> weight{};
  };
  static constexpr int kPlaceRounds = 8;  // the pitch is accurate to 30 %: 0.3^8 of a pitch remains

  template <typename Value>
  static int64_t sum(const MarkerWeights& weights, Value value) {
    int64_t total = 0;
    for (size_t k = 0; k < MarkerWeights::kCount; ++k) {
      total += weights.weight_q28[k] * value(static_cast<size_t>(weights.marker[k]));
    }
    return total;
  }
  static Taps taps(int64_t position_q16, int n_lines);
  [[nodiscard]] MarkerWeights on_lattice(int64_t a_q16, int64_t b_q16) const;
  [[nodiscard]] MarkerWeights on_lattice_of(size_t node, std::span<const PadPoint> rest) const;

  bool is_scattered_;
  GridSize lattice_;
  GridSize nodes_;
  PadPoint pitch_;
  std::vector<PadPoint> place_;    // of each node
  std::vector<PadPoint> nominal_;  // of each node on the board's lattice, Q16 pitches
  std::vector<MarkerWeights> weights_;
};

}  // namespace ruffini
