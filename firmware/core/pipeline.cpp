#include "core/pipeline.h"

#include <algorithm>
#include <string_view>

#include "core/hand_over.h"

namespace ruffini {
namespace {

// True if `names`, separated by spaces, contains the name.
bool has_any_kind(const Calibration& calibration, std::string_view names) {
  while (!names.empty()) {
    const size_t end = std::min(names.find(' '), names.size());
    if (calibration.has_kind(names.substr(0, end))) return true;
    names.remove_prefix(std::min(end + 1, names.size()));
  }
  return false;
}

}  // namespace

Pipeline::Pipeline(const BoardSettings& board, Rest& rest, FrameState& state, ClockFunction clock) : clock_(clock) {
  make_segments(board, state);
  SlotSet written;
  for (const Entry& entry : stages_) {
    written = written | entry.declared->writes;
    const FeatureSort& features = entry.declared->features;
    if (!features.name.empty()) segments_[entry.segment].state->features.sort = features;
  }
  bool has_lamp_features = false;
  for (const Segment& segment : segments_) has_lamp_features |= segment.state->features.sort.varies_by_lamp;
  for_each_stage(copy_slots, [&](Entry& entry) {
    SlotAccess slots(*segments_[entry.segment].state);
    entry.stage = entry.declared->make({board, slots, written, has_lamp_features, rest});
  });
}

void Pipeline::make_segments(const BoardSettings& board, FrameState& state) {
  const std::span<const StageEntry> table = stage_table();
  const std::vector<size_t> segment_of =
      board.n_cores > 1 ? segments_of(board.stages) : std::vector<size_t>(table.size());
  for (size_t row = 0; row < table.size(); ++row) {
    const std::string_view listed = table[row].part_of.empty() ? table[row].name : table[row].part_of;
    if (std::find(board.stages.begin(), board.stages.end(), listed) == board.stages.end()) continue;
    stages_.push_back({.declared = &table[row], .timed_as = stage_row(listed), .segment = segment_of[row]});
  }
  const size_t n = stages_.empty() ? 1 : stages_.back().segment + 1;
  for (size_t i = 0; i + 1 < n; ++i) {
    own_states_.push_back(std::make_unique<FrameState>(state));
    segments_.push_back({own_states_.back().get()});
  }
  segments_.push_back({&state});
  for (size_t i = 1; i < n; ++i) {
    SlotSet changed;
    SlotSet needed;
    for (const auto& [declared, timed_as, segment, stage, is_active] : stages_) {
      if (segment < i) changed = changed | declared->writes | declared->amends;
      if (segment >= i) needed = needed | declared->reads | declared->reads_if_written | declared->amends;
    }
    // The relative change of the picture is not sent, and it is large.
    segments_[i].received = needed.has(Slot::kDifference) ? changed : changed.without({Slot::kDifference});
  }
}

template <typename Pass, typename Each>
void Pipeline::for_each_stage(Pass pass, Each each) {
  size_t at = 0;
  const auto advance_to = [&](size_t segment) {
    for (; at < segment; ++at) pass(segments_[at + 1].received, *segments_[at].state, *segments_[at + 1].state);
  };
  for (Entry& entry : stages_) {
    advance_to(entry.segment);
    each(entry);
  }
  advance_to(segments_.size() - 1);
}

Status Pipeline::load(const Calibration* calibration, SlotSet written) {
  written_ = written;
  Status loaded = Unit{};
  for_each_stage(copy_slots, [&](Entry& entry) {
    const StageEntry& stage = *entry.declared;
    if (!loaded || !written_.has_all(stage.reads)) return;
    if (calibration != nullptr && has_any_kind(*calibration, stage.kind)) loaded = entry.stage->load(*calibration);
    if (!loaded) return;
    for (size_t i = 0; i < kSlotCount; ++i) {
      const auto slot = static_cast<Slot>(i);
      if (!(stage.writes | stage.amends).has(slot) || !entry.stage->writes(slot)) continue;
      if (stage.writes.has(slot)) written_.add(slot);
      entry.is_active = true;
    }
  });
  std::erase_if(stages_, [](const Entry& entry) { return !entry.is_active; });
  return loaded;
}

// The slots of the last frame go back to the segments that wrote them, so that learning changes the same as in a single
// segment, and come again.
void Pipeline::learn(std::span<const uint16_t> rest) {
  for (size_t i = segments_.size(); i-- > 1;) {
    hand_over(segments_[i].received, *segments_[i].state, *segments_[i - 1].state);
  }
  for_each_stage(hand_over, [&](const Entry& entry) { entry.stage->learn(rest); });
}

void Pipeline::enter(size_t segment, const Frame& frame) {
  if (segment > 0 && frame.is_measured) {
    hand_over(segments_[segment].received, *segments_[segment - 1].state, *segments_[segment].state);
  }
  for (const Entry& entry : stages_) {
    if (entry.segment == segment) entry.stage->begin();
  }
}

void Pipeline::run(const Entry& entry, Frame& frame) {
  const uint64_t start = clock_();
  entry.stage->run(frame);
  frame.stage_ns[entry.timed_as] += clock_() - start;
}

void Pipeline::run(size_t segment, Frame& frame) {
  for (const Entry& entry : stages_) {
    if (entry.segment == segment) run(entry, frame);
  }
}

void Pipeline::run_from(Slot slot, Frame& frame) {
  SlotSet changed = {slot};
  for (const Entry& entry : stages_) {
    const StageEntry& stage = *entry.declared;
    if (!changed.has_any(stage.reads | stage.reads_if_written)) continue;
    run(entry, frame);
    changed = changed | stage.writes;
  }
}

void Pipeline::compute(Slot slot, Frame& frame) {
  for (const Entry& entry : stages_) {
    if (!entry.declared->writes.has(slot)) continue;
    const uint64_t start = clock_();
    entry.stage->compute(slot, frame);
    frame.stage_ns[entry.timed_as] += clock_() - start;
  }
}

void Pipeline::judge(uint32_t& flags) {
  for (const Entry& entry : stages_) {
    if (entry.segment + 1 == segments_.size()) entry.stage->judge(flags);
  }
}

void Pipeline::forget() {
  for (const Entry& entry : stages_) entry.stage->forget();
}

void Pipeline::charge(Slot slot, uint64_t ns, Frame& frame) const {
  for (const Entry& entry : stages_) {
    if (entry.declared->writes.has(slot)) frame.stage_ns[entry.timed_as] += ns;
  }
}

}  // namespace ruffini
