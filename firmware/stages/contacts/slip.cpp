#include "stages/contacts/slip.h"

#include <algorithm>
#include <bit>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kOneQ16 = 1 << 16;
constexpr int64_t kSlack = SlipTracker::kSlackUm << DisplacementUm::kFrac;
constexpr int64_t kPeakPart = 5;  // the area consists of nodes above a fifth of the contact's largest pressure
constexpr int kMaxDepth = 7;
constexpr int kMinHeld = 4;         // minimum number of nodes for any result
constexpr int kMinTurned = 9;       // minimum number of nodes for a rotation
constexpr int64_t kMinSpread = 64;  // 2^20 um^2 times weight: gives the rotation to 2 %
constexpr int64_t kMaxRatio = 16 * kOneQ16;
constexpr uint8_t kHasSlid = 4;  // bit in Memory::phase beside the state

// 1000 (1 - (1 - x)^(2/3)) at x = 0, 1/32, ... 1: slipping share of a ball's contact that uses the fraction x of its
// friction.
constexpr std::array<int32_t, 33> kShare{0,   21,  42,  64,  85,  107, 129, 152, 175, 198, 221,
                                         245, 269, 294, 319, 344, 370, 397, 424, 451, 480, 509,
                                         539, 571, 603, 637, 672, 710, 750, 794, 843, 901, 1000};

int64_t share_of_used(int64_t used_1024) {
  const int64_t line = std::min<int64_t>(used_1024 >> 5, 31);
  const int64_t part = used_1024 - (line << 5);
  const auto at = static_cast<size_t>(line);
  return (kShare[at] * (32 - part) + kShare[at + 1] * part) >> 5;
}

// Returns the largest integer whose square is not above x.
int64_t square_root(uint64_t x) {
  uint64_t root = 0;
  for (uint64_t bit = uint64_t{1} << 31; bit != 0; bit >>= 1) {
    const uint64_t next = root | bit;
    if (next * next <= x) root = next;
  }
  return static_cast<int64_t>(root);
}

int64_t length(int64_t x, int64_t y) {
  return square_root(static_cast<uint64_t>(x * x) + static_cast<uint64_t>(y * y));
}

// Shear and pressure of a set of nodes.
struct Load {
  int64_t x = 0;
  int64_t y = 0;
  int64_t n = 0;
  int count = 0;

  void add(const NodeForce& f) {
    x += f.x;
    y += f.y;
    n -= f.z;
    ++count;
  }
  [[nodiscard]] uint64_t largest() const {
    const auto size = [](int64_t v) { return static_cast<uint64_t>(v < 0 ? -v : v); };
    return std::max({size(x), size(y), size(n)});
  }
  [[nodiscard]] Load shift_saturating(int by) const { return {x >> by, y >> by, n >> by, count}; }
};

// Contact quantities derived from the forces, ratios in Q16.
struct Ratios {
  bool is_known = false;  // the contact has a core and a rim
  int64_t tangential = 0;
  int64_t normal = 0;
  int shift = 0;  // common shift of these two, so that both fit 30 bits
  int64_t whole = 0;
  int64_t rim = 0;
  int64_t evenness_1e3 = 0;
};

int64_t ratio_q16(int64_t shear, int64_t pressure) {
  return std::clamp<int64_t>(floor_div(shear << 16, pressure), 0, kMaxRatio);
}

Ratios ratios_of(const Load& all, const Load& edge) {
  Ratios r;
  r.shift = std::max(static_cast<int>(std::bit_width(std::max(all.largest(), edge.largest()))) - 30, 0);
  const Load whole = all.shift_saturating(r.shift);
  const Load rim = edge.shift_saturating(r.shift);
  r.is_known = rim.count < whole.count && rim.n > 0 && whole.n > rim.n;
  if (!r.is_known) return r;
  r.normal = whole.n;
  r.tangential = length(whole.x, whole.y);
  const int64_t along = r.tangential > 0 ? floor_div(rim.x * whole.x + rim.y * whole.y, r.tangential) : 0;
  r.whole = ratio_q16(r.tangential, whole.n);
  r.rim = ratio_q16(along, rim.n);
  const int64_t core = ratio_q16(r.tangential - along, whole.n - rim.n);
  r.evenness_1e3 = r.rim > 0 ? 1'000 * core / r.rim : 0;
  return r;
}

// Determines the state from the known friction, and corrects the friction. The limits have a small hysteresis.
SlipState state_of(const Ratios& r, SlipState before, int64_t& friction) {
  if (r.evenness_1e3 >= 880 && 100 * r.whole >= 85 * friction) {
    friction += floor_div(r.whole - friction, 4);
  } else if (r.rim > friction) {
    friction += (r.rim - friction) / 4;
  }
  const int64_t used_1e3 = 1'000 * r.whole / friction;
  const bool has_let_go = used_1e3 >= 970 && r.evenness_1e3 >= 920;
  if (has_let_go || (before == SlipState::kSlides && used_1e3 >= 900)) return SlipState::kSlides;
  return used_1e3 >= (before >= SlipState::kIncipient ? 600 : 700) ? SlipState::kIncipient : SlipState::kSticks;
}

}  // namespace

SlipTracker::SlipTracker(const NodeGrid& grid, int64_t force_lsb_un)
    : grid_(grid),
      force_lsb_un_(force_lsb_un),
      memory_(static_cast<size_t>(grid.size().count())),
      state_(memory_.size()),
      depth_(memory_.size()),
      pressed_(memory_.size()) {
  for (int x = 0; x < grid.size().n_x; ++x) x_um_.push_back(static_cast<int32_t>(grid.to_um_x(grid.twice_steps_x(x))));
  for (int y = 0; y < grid.size().n_y; ++y) y_um_.push_back(static_cast<int32_t>(grid.to_um_y(grid.twice_steps_y(y))));
}

void SlipTracker::forget() {
  for (Memory& m : memory_) m.is_held = false;
}

void SlipTracker::track(const ContactList& contacts, std::span<const uint16_t> component,
                        std::span<const NodeForce> force, std::span<const NodeDisplacement> displacement) {
  std::fill(state_.begin(), state_.end(), NodeSlip::kFree);
  contacts_ = {};
  find_pressed(contacts, component, force);
  find_depth();
  for (size_t c = 0; c < static_cast<size_t>(contacts.n_listed); ++c) {
    const Members members{pressed_.data() + begin_[c], begin_[c + 1] - begin_[c]};
    const int n_slipped = follow(members, motion(members, displacement), displacement);
    contacts_[c] = judge(members, force, n_slipped);
  }
  for (size_t i = 0; i < memory_.size(); ++i) memory_[i].is_held = depth_[i] > 0;
}

void SlipTracker::find_pressed(const ContactList& contacts, std::span<const uint16_t> component,
                               std::span<const NodeForce> force) {
  std::fill(depth_.begin(), depth_.end(), uint8_t{0});
  size_t n = 0;
  for (size_t c = 0; c < static_cast<size_t>(contacts.n_listed); ++c) {
    begin_[c] = n;
    const uint16_t number = contacts.contacts[c].component;
    int64_t peak = 0;
    for (size_t i = 0; i < force.size(); ++i) {
      if (component[i] == number) peak = std::max(peak, -int64_t{force[i].z});
    }
    for (size_t i = 0; i < force.size(); ++i) {
      if (component[i] != number || -kPeakPart * force[i].z <= peak) continue;
      depth_[i] = kMaxDepth;
      pressed_[n++] = static_cast<int32_t>(i);
    }
    begin_[c + 1] = n;
  }
}

// Smallest depth of the four neighbours before (side -1) or after a node in reading order.
int SlipTracker::depth_from(int x, int y, int side) const {
  const GridSize n = grid_.size();
  const auto at = [&](int u, int v) -> int {
    if (u < 0 || v < 0 || u >= n.n_x || v >= n.n_y) return 0;
    return depth_[static_cast<size_t>(v * n.n_x + u)];
  };
  return std::min({at(x + side, y), at(x - 1, y + side), at(x, y + side), at(x + 1, y + side)});
}

// Chessboard distance to the nearest node that is not pressed, in two sweeps.
void SlipTracker::find_depth() {
  const GridSize n = grid_.size();
  const auto sweep = [&](int i, int side) {
    uint8_t& depth = depth_[static_cast<size_t>(i)];
    if (depth > 0) depth = static_cast<uint8_t>(std::min<int>(depth, depth_from(i % n.n_x, i / n.n_x, side) + 1));
  };
  for (int i = 0; i < n.count(); ++i) sweep(i, -1);
  for (int i = n.count() - 1; i >= 0; --i) sweep(i, 1);
}

SlipTracker::Place SlipTracker::moved(int32_t node, std::span<const NodeDisplacement> displacement) const {
  const auto i = static_cast<size_t>(node);
  return {displacement[i].x.raw() - memory_[i].anchor.x, displacement[i].y.raw() - memory_[i].anchor.y};
}

int64_t SlipTracker::weight(int32_t node) const {
  const int64_t d = depth_[static_cast<size_t>(node)];
  return d * d * d * d;
}

// Bounds: weight < 2^12, position < 2^18 um, motion < 2^18, nodes < 2^14: every sum is below 2^62.
SlipTracker::Motion SlipTracker::motion(Members members, std::span<const NodeDisplacement> displacement) const {
  const auto for_held = [&](auto work) {
    for (const int32_t node : members) {
      if (!memory_[static_cast<size_t>(node)].is_held) continue;
      const auto column = static_cast<size_t>(node % grid_.size().n_x);
      const auto row = static_cast<size_t>(node / grid_.size().n_x);
      work(weight(node), Place{x_um_[column], y_um_[row]}, moved(node, displacement));
    }
  };
  int n_held = 0;
  int64_t total = 0;
  Place sum;
  Place went;
  for_held([&](int64_t w, const Place& at, const Place& by) {
    ++n_held;
    total += w;
    sum = {sum.x + w * at.x, sum.y + w * at.y};
    went = {went.x + w * by.x, went.y + w * by.y};
  });
  if (total == 0) return {};
  Motion m{.about = {floor_div(sum.x, total), floor_div(sum.y, total)},
           .go = {floor_div(2 * went.x + total, 2 * total), floor_div(2 * went.y + total, 2 * total)}};
  int64_t spread = 0;
  int64_t twist = 0;
  for_held([&](int64_t w, const Place& at, const Place& by) {
    const Place arm{at.x - m.about.x, at.y - m.about.y};
    spread += w * (arm.x * arm.x + arm.y * arm.y);
    twist += w * (arm.x * (by.y - m.go.y) - arm.y * (by.x - m.go.x));
  });
  spread >>= 20;
  constexpr int64_t kMaxTurn = 1 << 20;
  if (n_held >= kMinTurned && spread >= kMinSpread) m.turn = std::clamp(floor_div(twist, spread), -kMaxTurn, kMaxTurn);
  return m;
}

// Moves anchors with the indenter; a node that lags behind drags its own. Returns the number of slipping nodes.
int SlipTracker::follow(Members members, const Motion& motion, std::span<const NodeDisplacement> displacement) {
  int n_slipped = 0;
  for (const int32_t node : members) {
    const auto i = static_cast<size_t>(node);
    const Place now{displacement[i].x.raw(), displacement[i].y.raw()};
    state_[i] = NodeSlip::kSticks;
    if (!memory_[i].is_held) {
      memory_[i].anchor = now;
      continue;
    }
    const int64_t arm_x = x_um_[static_cast<size_t>(node % grid_.size().n_x)] - motion.about.x;
    const int64_t arm_y = y_um_[static_cast<size_t>(node / grid_.size().n_x)] - motion.about.y;
    const Place by = moved(node, displacement);
    Place off{by.x - motion.go.x + ((motion.turn * arm_y) >> 20), by.y - motion.go.y - ((motion.turn * arm_x) >> 20)};
    if (off.x * off.x + off.y * off.y >= kSlack * kSlack) {
      const int64_t distance = length(off.x, off.y);
      off = {floor_div(off.x * kSlack, distance), floor_div(off.y * kSlack, distance)};
      state_[i] = NodeSlip::kSlips;
      ++n_slipped;
    }
    memory_[i].anchor = {now.x - off.x, now.y - off.y};
  }
  return n_slipped;
}

ContactSlip SlipTracker::judge(Members members, std::span<const NodeForce> force, int n_slipped) {
  Load whole;
  Load rim;
  int n_held = 0;
  int64_t friction = 0;
  uint8_t phase = 0;
  for (const int32_t node : members) {
    const auto i = static_cast<size_t>(node);
    whole.add(force[i]);
    if (depth_[i] == 1) rim.add(force[i]);
    if (!memory_[i].is_held) continue;
    ++n_held;
    friction = std::max(friction, memory_[i].friction);
    phase = std::max(phase, memory_[i].phase);
  }
  const auto store = [&] {
    for (const int32_t node : members) {
      memory_[static_cast<size_t>(node)].friction = friction;
      memory_[static_cast<size_t>(node)].phase = phase;
    }
  };
  const Ratios r = ratios_of(whole, rim);
  if (n_held < kMinHeld || !r.is_known) return store(), ContactSlip{};
  ContactSlip slip{.state = SlipState::kSticks};
  int64_t share_1e3 = 1'000 * int64_t{n_slipped} / whole.count;
  if (friction > 0) {
    slip.state = state_of(r, static_cast<SlipState>(phase & 3), friction);
  } else if (share_1e3 >= 350 && r.evenness_1e3 >= 600 && 100 * r.whole >= 3 * kOneQ16) {
    friction = r.rim;
    slip.state = SlipState::kIncipient;
  }
  const bool has_slid = slip.state == SlipState::kSlides || (phase & kHasSlid) != 0;
  phase = static_cast<uint8_t>(static_cast<uint8_t>(slip.state) | (has_slid ? kHasSlid : 0));
  if (slip.state == SlipState::kSlides) {
    share_1e3 = 1'000;
  } else if (friction > 0) {
    share_1e3 = std::max(share_1e3, share_of_used(std::min<int64_t>(1'024 * r.whole / friction, 1'024)));
  }
  const auto to_1e3 = [](int64_t q16) { return static_cast<int32_t>((1'000 * q16) >> 16); };
  slip.ratio_1e3 = to_1e3(r.whole);
  slip.friction_1e3 = to_1e3(friction);
  slip.friction_sigma_1e3 = to_1e3(friction * (has_slid ? 3 : 20) / 100);
  slip.share_1e3 = static_cast<int32_t>(share_1e3);
  if (friction > 0) {
    slip.margin_un = ((((friction * r.normal) >> 16) - r.tangential) << r.shift) * force_lsb_un_;
  }
  store();
  mark(members, force, slip.state, friction);
  return slip;
}

// Nodes at nine tenths of the friction slip as well; all nodes do if the contact slides.
void SlipTracker::mark(Members members, std::span<const NodeForce> force, SlipState state, int64_t friction) {
  for (const int32_t node : members) {
    const auto i = static_cast<size_t>(node);
    const NodeForce& f = force[i];
    const bool is_at_limit = friction > 0 && 10 * kOneQ16 * length(f.x, f.y) >= -9 * friction * f.z;
    if (state == SlipState::kSlides || is_at_limit) state_[i] = NodeSlip::kSlips;
  }
}

}  // namespace ruffini
