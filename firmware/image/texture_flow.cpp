#include "image/texture_flow.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr std::array<PatchShape, 3> kShapes = {{{.n_blocks = 2, .row_step = 2, .margin_px = 1},
                                                {.n_blocks = 1, .row_step = 1, .margin_px = 1},
                                                {.n_blocks = 1, .row_step = 1, .margin_px = 4}}};
static_assert(kShapes[2].margin_px >= FlowTemplates::kSearchPx);

// Swaps so that a <= b.
void order(int32_t& a, int32_t& b) {
  const int32_t low = std::min(a, b);
  b = std::max(a, b);
  a = low;
}

// Median of nine: sorts three columns, then takes the median of the largest minimum, the middle median and the smallest
// maximum.
int32_t median_of(std::array<int32_t, 9> v) {
  for (size_t i = 0; i < 9; i += 3) {
    order(v[i], v[i + 1]);
    order(v[i + 1], v[i + 2]);
    order(v[i], v[i + 1]);
  }
  const int32_t low = std::max({v[0], v[3], v[6]});
  const int32_t high = std::min({v[2], v[5], v[8]});
  order(v[1], v[4]);
  const int32_t middle = std::max(v[1], std::min(v[4], v[7]));
  return std::max(std::min(low, middle), std::min(std::max(low, middle), high));
}

}  // namespace

TextureFlow::TextureFlow(const BoardSettings& board)
    : lattice_(board.markers.lattice),
      graph_(lattice_),
      coarse_lattice_{(lattice_.n_x + 1) / 2, (lattice_.n_y + 1) / 2},
      threshold_1e3_(static_cast<int>(board.markers.threshold_1e3)),
      mean_(static_cast<size_t>(board.camera.width_px) + 2),
      row_(static_cast<size_t>(board.camera.width_px) * 3),
      colours_({board.camera.width_px, board.camera.height_px}, static_cast<size_t>(lattice_.count())) {
  const CameraSettings& camera = board.camera;
  GridSize size{camera.width_px, camera.height_px};
  for (Picture& picture : picture_) {
    picture = {size, std::vector<int16_t>(static_cast<size_t>(size.count()))};
    size = {size.n_x / 2, size.n_y / 2};
  }
  const MarkerSettings& m = board.markers;
  const int64_t um_to_px_q32 = floor_div(camera.focal_mpx * (int64_t{1} << 32), camera.standoff_um * 1000);
  const auto place = [&](int64_t center_mpx, int64_t pad_um, int64_t first_um, int64_t pitch_um, int line) {
    const int64_t corner = floor_div(center_mpx * 65536 + 500, 1000) - (pad_um * um_to_px_q32 >> 17);
    return static_cast<int32_t>(corner + ((first_um + line * pitch_um) * um_to_px_q32 >> 16));
  };
  for (int y = 0; y < lattice_.n_y; ++y) {
    for (int x = 0; x < lattice_.n_x; ++x) {
      const FlowVector at{place(camera.center_x_mpx, board.pad.size_x_um, m.first_x_um, m.pitch_x_um, x),
                          place(camera.center_y_mpx, board.pad.size_y_um, m.first_y_um, m.pitch_y_um, y)};
      place_[0].push_back(at);
      if (x % 2 == 0 && y % 2 == 0) place_[1].push_back(at);
    }
  }
  const auto n = static_cast<size_t>(lattice_.count());
  for (size_t level = 0; level < kLevels; ++level) {
    templates_.emplace_back(kShapes[level], level < 2 ? lattice_.count() : coarse_lattice_.count());
  }
  coarse_.resize(place_[1].size());
  coarse_next_.resize(place_[1].size());
  u_.resize(n);
  is_cut_.resize(n);
  known_.resize(n);
  known_next_.resize(n);
  markers_.resize(n);
}

// Computes level 0 row by row; its mean and its smoothing along x are three rows ahead.
void TextureFlow::smooth(std::span<const uint16_t> grey) {
  const auto width = static_cast<size_t>(picture_[0].size.n_x);
  const int height = picture_[0].size.n_y;
  const auto row_of = [&](int y) { return row_.data() + static_cast<size_t>(y % 3) * width; };
  const auto along_x = [&](int y) {
    const uint16_t* from = grey.data() + static_cast<size_t>(y) * width;
    int16_t* mean = mean_.data() + 1;
    for (size_t x = 0; x < width; ++x) mean[x] = static_cast<int16_t>((uint32_t{from[x]} * 85 + 128) >> 8);
    mean[-1] = mean[0];
    mean[width] = mean[width - 1];
    int16_t* to = row_of(y);
    for (size_t x = 0; x < width; ++x) to[x] = static_cast<int16_t>(mean_[x] + 2 * mean_[x + 1] + mean_[x + 2]);
  };
  along_x(0);
  for (int y = 0; y < height; ++y) {
    if (y + 1 < height) along_x(y + 1);
    const int16_t* above = row_of(std::max(y - 1, 0));
    const int16_t* here = row_of(y);
    const int16_t* below = row_of(std::min(y + 1, height - 1));
    int16_t* to = picture_[0].pixels.data() + static_cast<size_t>(y) * width;
    for (size_t x = 0; x < width; ++x) to[x] = static_cast<int16_t>((above[x] + 2 * here[x] + below[x] + 8) >> 4);
  }
}

void TextureFlow::halve(const Picture& from, Picture& to) {
  const auto width = static_cast<size_t>(from.size.n_x);
  const auto n_x = static_cast<size_t>(to.size.n_x);
  for (size_t y = 0; y < static_cast<size_t>(to.size.n_y); ++y) {
    const int16_t* upper = from.pixels.data() + 2 * y * width;
    const int16_t* lower = upper + width;
    int16_t* out = to.pixels.data() + y * n_x;
    for (size_t x = 0; x < n_x; ++x) {
      out[x] = static_cast<int16_t>((upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) >> 2);
    }
  }
}

void TextureFlow::build_pyramid(std::span<const uint16_t> grey) {
  smooth(grey);
  halve(picture_[0], picture_[1]);
  halve(picture_[1], picture_[2]);
}

int TextureFlow::learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest) {
  build_pyramid(grey);
  colours_.learn(rest, place_[0]);
  for (size_t level = 0; level < kLevels; ++level) {
    const std::vector<FlowVector>& from = place_[level < 2 ? 0 : 1];
    std::vector<FlowVector>& scaled = level < 2 ? u_ : coarse_;
    // Pixel centres: (p + 1/2) / 2^level - 1/2.
    std::transform(from.begin(), from.end(), scaled.begin(), [&](const FlowVector& p) {
      const auto at = [&](int32_t q16) { return ((q16 + 32'768) >> level) - 32'768; };
      return FlowVector{at(p.x_q16), at(p.y_q16)};
    });
    templates_[level].learn(picture_[level].view(), scaled);
  }
  int n_found = 0;
  for (size_t i = 0; i < markers_.size(); ++i) {
    const bool is_sound = templates_[0].is_sound(i);
    // The displacement from grey applies to the patch's centre of texture.
    const FlowVector center = colours_.is_sound(i) ? place_[0][i] : templates_[0].center(i);
    markers_[i] = Marker{};
    markers_[i].rest_x = ImagePx::from_raw(center.x_q16);
    markers_[i].rest_y = ImagePx::from_raw(center.y_q16);
    markers_[i].is_lost = markers_[i].is_absent = !is_sound;
    n_found += is_sound ? 1 : 0;
  }
  return n_found;
}

// Median over 3 x 3 coarse patches, per component; the border is repeated.
void TextureFlow::median() {
  const int n_x = coarse_lattice_.n_x;
  const int n_y = coarse_lattice_.n_y;
  for (int y = 0; y < n_y; ++y) {
    for (int x = 0; x < n_x; ++x) {
      std::array<int32_t, 9> around_x{};
      std::array<int32_t, 9> around_y{};
      size_t i = 0;
      for (int v = y - 1; v <= y + 1; ++v) {
        for (int u = x - 1; u <= x + 1; ++u, ++i) {
          const FlowVector& one =
              coarse_[static_cast<size_t>(std::clamp(v, 0, n_y - 1) * n_x + std::clamp(u, 0, n_x - 1))];
          around_x[i] = one.x_q16;
          around_y[i] = one.y_q16;
        }
      }
      coarse_next_[static_cast<size_t>(y * n_x + x)] = {median_of(around_x), median_of(around_y)};
    }
  }
  std::swap(coarse_, coarse_next_);
}

void TextureFlow::spread() {
  size_t i = 0;
  for (int y = 0; y < lattice_.n_y; ++y) {
    const int row = std::min((y + 1) / 2, coarse_lattice_.n_y - 1) * coarse_lattice_.n_x;
    for (int x = 0; x < lattice_.n_x; ++x, ++i) {
      const FlowVector& from = coarse_[static_cast<size_t>(row + std::min((x + 1) / 2, coarse_lattice_.n_x - 1))];
      u_[i] = {2 * from.x_q16, 2 * from.y_q16};
    }
  }
}

int TextureFlow::track(std::span<const uint16_t> grey, const FrameView& frame) {
  build_pyramid(grey);
  templates_[2].search(picture_[2].view(), coarse_);
  median();
  templates_[2].step(picture_[2].view(), coarse_, is_cut_);
  median();
  spread();
  templates_[1].step(picture_[1].view(), u_, is_cut_);
  for (FlowVector& u : u_) u = {2 * u.x_q16, 2 * u.y_q16};
  templates_[0].step(picture_[0].view(), u_, is_cut_);
  templates_[0].compare(picture_[0].view(), u_, threshold_1e3_, known_);
  colours_.step(frame, u_, is_cut_, known_);
  int n_lost = 0;
  for (size_t i = 0; i < markers_.size(); ++i) {
    Marker& marker = markers_[i];
    if (marker.is_absent || is_cut_[i] != 0) known_[i] = 0;
    marker.quality = known_[i];
    marker.displacement_x = ImagePx::from_raw(u_[i].x_q16);
    marker.displacement_y = ImagePx::from_raw(u_[i].y_q16);
    marker.is_lost = known_[i] == 0;
    n_lost += marker.is_lost && !marker.is_absent ? 1 : 0;
  }
  graph_.fill(markers_, known_, known_next_);
  return n_lost;
}

}  // namespace ruffini
