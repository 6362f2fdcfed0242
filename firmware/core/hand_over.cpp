#include "core/hand_over.h"

#include <tuple>
#include <utility>

namespace ruffini {
namespace {

// Exchanges the large members, and copies the others.
template <typename Data, typename... Members>
void pass(Data& from, Data& to, Members... large) {
  std::tuple fresh{std::move(from.*large)...};
  std::tuple spare{std::move(to.*large)...};
  to = from;
  std::tie(to.*large...) = std::move(fresh);
  std::tie(from.*large...) = std::move(spare);
}

template <Slot slot>
void pass(FrameState& from, FrameState& to) {
  using Data = SlotData<slot>;
  Data& old = slot_of<slot>(from);
  Data& next = slot_of<slot>(to);
  if constexpr (slot == Slot::kDifference) {
    pass(old, next, &Data::change, &Data::grey);
  } else if constexpr (slot == Slot::kSlope) {
    pass(old, next, &Data::slope, &Data::depth);
  } else if constexpr (slot == Slot::kDepth) {
    pass(old, next, &Data::cell);
  } else {
    next = old;
  }
}

template <typename Each>
void for_each(SlotSet slots, Each each) {
  using enum Slot;
  const auto visit = [&]<Slot slot>() {
    if (slots.has(slot)) each.template operator()<slot>();
  };
  const auto visit_all = [&]<Slot... all>() { (visit.template operator()<all>(), ...); };
  static_assert(kHandedOver ==
                SlotSet{kDifference, kLight, kMarkers, kTargets, kFeatures, kSlope, kDepth, kDisplacement});
  visit_all.template operator()<kDifference, kLight, kMarkers, kTargets, kFeatures, kSlope, kDepth, kDisplacement>();
}

}  // namespace

void hand_over(SlotSet slots, FrameState& from, FrameState& to) {
  for_each(slots, [&]<Slot slot>() { pass<slot>(from, to); });
}

void copy_slots(SlotSet slots, const FrameState& from, FrameState& to) {
  for_each(slots, [&]<Slot slot>() { slot_of<slot>(to) = slot_of<slot>(from); });
}

}  // namespace ruffini
