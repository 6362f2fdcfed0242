// Relative change of each pixel from rest, and grey (image/difference.h).
#include <algorithm>

#include "core/stages.h"
#include "image/difference.h"

namespace ruffini {
namespace {

class DifferenceStage final : public Stage {
 public:
  explicit DifferenceStage(const StageContext& c)
      : n_pixels_(c.board.camera.width_px * c.board.camera.height_px),
        n_views_(c.board.markers.has_views ? c.board.markers.lattice.n_y : 1),
        has_light_markers_(c.board.markers.lattice.count() > 0 && c.board.markers.polarity == Polarity::kLight),
        n_lit_(n_pixels_),
        rest_(c.rest),
        difference_(c.slots.write<Slot::kDifference>()) {
    const auto n = static_cast<size_t>(n_pixels_);
    difference_.change.resize(3 * n);
    difference_.grey.resize(n);
  }

  // Grey of the rest image in the format of a frame (image/difference.h), from 1/16 levels.
  void learn(std::span<const uint16_t> rest) override {
    for (size_t i = 0; i < difference_.grey.size(); ++i) {
      const int sum = rest[3 * i] + 2 * rest[3 * i + 1] + rest[3 * i + 2];
      difference_.grey[i] = static_cast<uint16_t>((3 * sum + 2) >> 2);
    }
    if (has_light_markers_) n_lit_ = lit(rest);
  }

  void run(Frame& frame) override {
    difference_.exposure = difference(frame.view, rest_, difference_.change, difference_.grey);
    // One of several views may be dark.
    const int n_darker = difference_.exposure.dark - (n_pixels_ - n_lit_);
    if (n_darker * 2 > n_lit_ * (2 * n_views_ - 1) / n_views_) frame.flags |= kFlagDark;
    if (difference_.exposure.full * 20 > n_pixels_) frame.flags |= kFlagOverexposed;
  }

 private:
  // Pixels that are not dark at rest. The ground of light markers may be black; all pixels count if next to nothing is
  // lit, as in a picture without lamps.
  [[nodiscard]] int lit(std::span<const uint16_t> rest) const {
    int n = 0;
    for (size_t i = 0; i < rest.size(); i += 3) {
      n += std::max({rest[i], rest[i + 1], rest[i + 2]}) >= 16 * kDarkLevel ? 1 : 0;
    }
    return n * kLeastLit < n_pixels_ ? n_pixels_ : n;
  }

  static constexpr int kLeastLit = 256;  // one pixel in so many
  int n_pixels_;
  int n_views_;
  bool has_light_markers_;
  int n_lit_;
  const Rest& rest_;
  SlotData<Slot::kDifference>& difference_;
};

}  // namespace

StagePointer make_difference(const StageContext& context) { return std::make_unique<DifferenceStage>(context); }

}  // namespace ruffini
