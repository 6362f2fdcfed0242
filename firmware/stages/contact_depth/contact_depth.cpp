#include "stages/contact_depth/contact_depth.h"

#include <algorithm>
#include <utility>

#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int kFewTimes = 2;
constexpr int kManyTimes = 8;
constexpr int64_t kMaxInput = Perceptron::kMaxInput;
constexpr int64_t kMaxDepthQ4 = 4'000 << 4;  // limit of DisplacementUm: 1/8 um in 16 bits
constexpr int64_t kMaxRatioQ12 = int64_t{1} << 20;
constexpr int kRounds = 2;

// Position of a value between the lines of a lattice: line and fraction of a step, Q10.
struct Between {
  int line = 0;
  int64_t part_q10 = 0;
};

Between between(int64_t from_first_q4, int64_t pitch_um, int n) {
  const int64_t at_q10 = std::clamp<int64_t>(floor_div(from_first_q4 << 6, pitch_um), 0, int64_t{n - 1} << 10);
  const int line = std::min(static_cast<int>(at_q10 >> 10), n - 2);
  return {line, at_q10 - (int64_t{line} << 10)};
}

template <typename Value>
int64_t bilinear(Value value, const Between& x, const Between& y) {
  const auto row = [&](int j) { return (1'024 - x.part_q10) * value(x.line, j) + x.part_q10 * value(x.line + 1, j); };
  return round_shift((1'024 - y.part_q10) * row(y.line) + y.part_q10 * row(y.line + 1), 20);
}

}  // namespace

bool ContactDepth::is_used_by(const BoardSettings& board) {
  const auto has = [&](const char* stage) {
    return std::find(board.stages.begin(), board.stages.end(), stage) != board.stages.end();
  };
  return has("contact_depth") && !has("photometric");
}

int ContactDepth::step_px(const BoardSettings& board) {
  const int64_t pitch_um = std::min(board.markers.pitch_x_um, board.markers.pitch_y_um);
  const int64_t pitch_px = pitch_um * board.camera.focal_mpx / (1'000 * board.camera.standoff_um);
  return static_cast<int>(std::max<int64_t>(pitch_px, board.depth.step_px));
}

GridSize ContactDepth::cells(const BoardSettings& board) {
  const int step = step_px(board);
  return {board.camera.width_px / step, board.camera.height_px / step};
}

ContactDepth::ContactDepth(const BoardSettings& board)
    : lattice_(board.markers.lattice),
      cells_(cells(board)),
      pitch_{board.markers.pitch_x_um, board.markers.pitch_y_um},
      first_{(2 * board.markers.first_x_um - board.pad.size_x_um) << 3,
             (2 * board.markers.first_y_um - board.pad.size_y_um) << 3},
      step_px_(step_px(board)),
      um_per_px_q20_(floor_div(board.camera.standoff_um * 1'000 << 20, board.camera.focal_mpx)),
      center_x_mpx_(board.camera.center_x_mpx),
      center_y_mpx_(board.camera.center_y_mpx),
      seen_(2 * static_cast<size_t>(lattice_.count())),
      line_(static_cast<size_t>(lattice_.count())),
      depth_q4_(static_cast<size_t>(lattice_.count())) {
  for (std::vector<int64_t>& plane : plane_) plane.resize(static_cast<size_t>(lattice_.count()));
}

Result<ContactDepth> ContactDepth::load(const Calibration& c, const BoardSettings& board) {
  if (board.markers.lattice.n_x < 2 || board.markers.lattice.n_y < 2) {
    return Error{ErrorKind::kBadInput, "calibration file: contact_depth needs two patches each way: leave it out"};
  }
  ContactDepth out(board);
  const int n = out.lattice_.count();
  auto linear = BlockProgram::load(c, "contact_depth.linear", 2 * n, n);
  if (!linear) return linear.error();
  out.linear_ = std::move(linear).value();
  auto tanh = TanhTable::load(c, "contact_model.tanh");
  if (!tanh) return tanh.error();
  out.tanh_ = std::move(tanh).value();
  auto net = Perceptron::load(c, "contact_depth.net", static_cast<int>(kInputs), 1);
  if (!net) return net.error();
  out.net_ = std::move(net).value();
  const auto sigma = c.integer("contact_depth.sigma_um", 1, 10'000);
  if (!sigma) return sigma.error();
  out.sigma_um_ = sigma.value();
  return out;
}

// Smooths by (1 2 1) both ways; borders are repeated.
void ContactDepth::smooth(std::vector<int64_t>& plane) {
  const int n_x = lattice_.n_x;
  const int n_y = lattice_.n_y;
  for (int y = 0; y < n_y; ++y) {
    const int64_t* row = plane.data() + ptrdiff_t{y} * n_x;
    int64_t* out = line_.data() + ptrdiff_t{y} * n_x;
    for (int x = 0; x < n_x; ++x) out[x] = row[std::max(x - 1, 0)] + 2 * row[x] + row[std::min(x + 1, n_x - 1)];
  }
  for (int y = 0; y < n_y; ++y) {
    const int64_t* above = line_.data() + ptrdiff_t{std::max(y - 1, 0)} * n_x;
    const int64_t* here = line_.data() + ptrdiff_t{y} * n_x;
    const int64_t* below = line_.data() + ptrdiff_t{std::min(y + 1, n_y - 1)} * n_x;
    int64_t* out = plane.data() + ptrdiff_t{y} * n_x;
    for (int x = 0; x < n_x; ++x) out[x] = round_shift(above[x] + 2 * here[x] + below[x], 4);
  }
}

void ContactDepth::estimate(std::span<const FlowPoint> flow, SaturationCounter& saturations) {
  for (size_t i = 0; i < flow.size(); ++i) {
    seen_[2 * i] = saturate_raw<int16_t>(flow[i].x_q4, saturations);
    seen_[2 * i + 1] = saturate_raw<int16_t>(flow[i].y_q4, saturations);
  }
  linear_.run(seen_, plane_[0]);
  plane_[1] = plane_[0];
  for (int i = 0; i < kFewTimes; ++i) smooth(plane_[1]);
  plane_[2] = plane_[1];
  for (int i = kFewTimes; i < kManyTimes; ++i) smooth(plane_[2]);
}

void ContactDepth::refine(std::span<const int32_t> fall, const Profile& profile, const ModelledContact::Inputs& inputs,
                          SaturationCounter& saturations) {
  const int64_t size = std::max<int64_t>(profile.size_q4, 1);
  const auto over_size = [&](int64_t value, int shift) {
    return std::clamp(floor_div(value << shift, size), -kMaxInput, kMaxInput);
  };
  std::array<int64_t, kInputs> x{};
  std::copy(inputs.begin(), inputs.end(), x.begin() + kOfPatch);
  x[3] = over_size(*std::max_element(plane_[0].begin(), plane_[0].end()), 10);
  size_t i = 0;
  for (int row = 0; row < lattice_.n_y; ++row) {
    const int64_t dy = ((first_.y_q4 + (row * pitch_.y_q4 << 4)) >> 4) - profile.center_y_um;
    for (int column = 0; column < lattice_.n_x; ++column, ++i) {
      const int64_t dx = ((first_.x_q4 + (column * pitch_.x_q4 << 4)) >> 4) - profile.center_x_um;
      for (size_t k = 0; k < plane_.size(); ++k) x[k] = over_size(plane_[k][i], 10);
      x[4] = over_size(fall[i], 8);
      x[5] = floor_sqrt(dx * dx + dy * dy);
      int64_t ratio_q12 = 0;
      net_.run(tanh_, x, {&ratio_q12, 1}, saturations);
      const int64_t depth = round_shift(std::clamp(ratio_q12, -kMaxRatioQ12, kMaxRatioQ12) * profile.size_q4, 12);
      depth_q4_[i] = std::clamp(depth, -kMaxDepthQ4, kMaxDepthQ4);
      if (depth != depth_q4_[i]) ++saturations.count;
    }
  }
}

void ContactDepth::resample(std::span<const FlowPoint> flow, std::span<DisplacementUm> out,
                            SaturationCounter& saturations) const {
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * lattice_.n_x + x); };
  const auto place_q4 = [&](int cell, int64_t center_mpx) {
    const int64_t twice_mpx = (2 * cell * step_px_ + step_px_ - 1) * 1'000 - 2 * center_mpx;
    return floor_div(round_shift(twice_mpx * um_per_px_q20_, 20 + 1 - 4), 1'000);
  };
  for (int row = 0; row < cells_.n_y; ++row) {
    for (int column = 0; column < cells_.n_x; ++column) {
      const FlowPoint seen{place_q4(column, center_x_mpx_) - first_.x_q4, place_q4(row, center_y_mpx_) - first_.y_q4};
      FlowPoint lay = seen;
      Between x = between(lay.x_q4, pitch_.x_q4, lattice_.n_x);
      Between y = between(lay.y_q4, pitch_.y_q4, lattice_.n_y);
      for (int round = 0; round < kRounds; ++round) {
        lay.x_q4 = seen.x_q4 - bilinear([&](int i, int j) { return flow[at(i, j)].x_q4; }, x, y);
        lay.y_q4 = seen.y_q4 - bilinear([&](int i, int j) { return flow[at(i, j)].y_q4; }, x, y);
        x = between(lay.x_q4, pitch_.x_q4, lattice_.n_x);
        y = between(lay.y_q4, pitch_.y_q4, lattice_.n_y);
      }
      const int64_t depth_q4 = bilinear([&](int i, int j) { return depth_q4_[at(i, j)]; }, x, y);
      out[static_cast<size_t>(row * cells_.n_x + column)] =
          DisplacementUm::from_raw(saturate_raw<int16_t>(-round_shift(depth_q4, 1), saturations));
    }
  }
}

void ContactDepth::run(const Profile& profile, const ModelledContact::Inputs& inputs, std::span<DisplacementUm> out,
                       SaturationCounter& saturations) {
  estimate(profile.flow, saturations);
  refine(profile.fall, profile, inputs, saturations);
  resample(profile.flow, out, saturations);
}

}  // namespace ruffini
