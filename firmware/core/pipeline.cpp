#include "core/pipeline.h"

#include <algorithm>
#include <string_view>

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

Pipeline::Pipeline(const BoardSettings& board, Rest& rest, FrameState& state, ClockFunction clock)
    : state_(state), clock_(clock) {
  SlotAccess slots(state);
  SlotSet written;
  for (const StageEntry& stage : stage_table()) {
    const std::string_view listed = stage.part_of.empty() ? stage.name : stage.part_of;
    if (std::find(board.stages.begin(), board.stages.end(), listed) == board.stages.end()) continue;
    stages_.push_back({.declared = &stage, .timed_as = stage_row(listed)});
    written = written | stage.writes;
    if (!stage.features.name.empty()) state.features.sort = stage.features;
  }
  const bool has_lamp_features = state.features.sort.varies_by_lamp;
  for (Entry& entry : stages_) entry.stage = entry.declared->make({board, slots, written, has_lamp_features, rest});
}

Status Pipeline::load(const Calibration* calibration, SlotSet written) {
  written_ = written;
  for (Entry& entry : stages_) {
    const StageEntry& stage = *entry.declared;
    if (!written_.has_all(stage.reads)) continue;
    if (calibration != nullptr && has_any_kind(*calibration, stage.kind)) {
      if (Status loaded = entry.stage->load(*calibration); !loaded) return loaded;
    }
    for (size_t i = 0; i < kSlotCount; ++i) {
      const auto slot = static_cast<Slot>(i);
      if (!(stage.writes | stage.amends).has(slot) || !entry.stage->writes(slot)) continue;
      if (stage.writes.has(slot)) written_.add(slot);
      entry.is_active = true;
    }
  }
  std::erase_if(stages_, [](const Entry& entry) { return !entry.is_active; });
  return Unit{};
}

void Pipeline::learn(std::span<const uint16_t> rest) {
  for (const Entry& entry : stages_) entry.stage->learn(rest);
}

void Pipeline::begin() {
  for (const Entry& entry : stages_) entry.stage->begin();
}

void Pipeline::run(const Entry& entry, Frame& frame) {
  const uint64_t start = clock_();
  entry.stage->run(frame);
  state_.stage_ns[entry.timed_as] += clock_() - start;
}

void Pipeline::run(Frame& frame) {
  for (const Entry& entry : stages_) run(entry, frame);
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
    state_.stage_ns[entry.timed_as] += clock_() - start;
  }
}

void Pipeline::judge(uint32_t& flags) {
  for (const Entry& entry : stages_) entry.stage->judge(flags);
}

void Pipeline::forget() {
  for (const Entry& entry : stages_) entry.stage->forget();
}

void Pipeline::charge(Slot slot, uint64_t ns) {
  for (const Entry& entry : stages_) {
    if (entry.declared->writes.has(slot)) state_.stage_ns[entry.timed_as] += ns;
  }
}

}  // namespace ruffini
