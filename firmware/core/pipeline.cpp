#include "core/pipeline.h"

#include <algorithm>
#include <utility>

namespace ruffini {

Pipeline::Pipeline(const BoardSettings& board, FrameState& state, ClockFunction clock) : state_(state), clock_(clock) {
  SlotAccess slots(state);
  const std::span<const StageEntry> table = stage_table();
  for (const std::string& name : board.stages) {
    const auto at = std::find_if(table.begin(), table.end(), [&](const StageEntry& each) { return each.name == name; });
    if (at == table.end() || at->make == nullptr) continue;
    stages_.push_back({.index = static_cast<size_t>(at - table.begin()), .stage = at->make({board, slots})});
  }
}

Status Pipeline::load(const Calibration* calibration, SlotSet written) {
  written_ = written;
  for (Entry& entry : stages_) {
    const StageEntry& stage = declared(entry);
    if (!written_.has_all(stage.reads)) continue;
    if (calibration != nullptr && !stage.kind.empty() && calibration->has_kind(stage.kind)) {
      if (Status loaded = entry.stage->load(*calibration); !loaded) return loaded;
    }
    for (size_t i = 0; i < kSlotCount; ++i) {
      const auto slot = static_cast<Slot>(i);
      if (!stage.writes.has(slot) || !entry.stage->writes(slot)) continue;
      written_.add(slot);
      entry.is_active = true;
    }
  }
  std::erase_if(stages_, [](const Entry& entry) { return !entry.is_active; });
  return Unit{};
}

void Pipeline::learn(std::span<const uint16_t> rest) {
  for (const Entry& entry : stages_) entry.stage->learn(rest);
}

void Pipeline::run(const Entry& entry, Frame& frame) {
  const uint64_t start = clock_();
  entry.stage->run(frame);
  state_.stage_ns[entry.index] = clock_() - start;
}

void Pipeline::run(Frame& frame) {
  for (const Entry& entry : stages_) run(entry, frame);
}

void Pipeline::run_from(Slot slot, Frame& frame) {
  SlotSet changed = {slot};
  for (const Entry& entry : stages_) {
    const StageEntry& stage = declared(entry);
    if (!changed.has_any(stage.reads | stage.reads_if_written)) continue;
    run(entry, frame);
    changed = changed | stage.writes;
  }
}

void Pipeline::judge(uint32_t& flags) {
  for (const Entry& entry : stages_) entry.stage->judge(flags);
}

void Pipeline::forget() {
  for (const Entry& entry : stages_) entry.stage->forget();
}

}  // namespace ruffini
