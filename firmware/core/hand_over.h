// Hands a frame's slots from one segment of stages to the next (core/stages.h), each of which has a FrameState of its
// own: what is as large as a picture changes places, so that the slots are double-buffered, the rest is copied.
//
// Frame threads: the one that holds both segments. No allocation, once both states have the same sizes.
#pragma once

#include "core/slots.h"

namespace ruffini {

// Slots whose data belong to themselves and not to the stage that writes them.
inline constexpr SlotSet kHandedOver = {Slot::kDifference, Slot::kLight, Slot::kMarkers, Slot::kTargets,
                                        Slot::kFeatures,   Slot::kSlope, Slot::kDepth,   Slot::kDisplacement};

// Precondition of both: `slots` are of kHandedOver. hand_over() leaves old pictures in `from`, which their writers
// overwrite.
void hand_over(SlotSet slots, FrameState& from, FrameState& to);
void copy_slots(SlotSet slots, const FrameState& from, FrameState& to);

}  // namespace ruffini
