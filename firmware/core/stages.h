// The table of the stages (stages.cpp), in the only order in which a board may list them.
#pragma once

#include <memory>
#include <span>
#include <string_view>

#include "core/slots.h"
#include "core/stage.h"

namespace ruffini {

struct StageEntry {
  std::string_view name;  // in [pipeline] stages of board.toml
  SlotSet reads;          // the stage is not run unless a stage before it writes all of these
  SlotSet reads_if_written;
  SlotSet writes;
  std::string_view sections;  // of board.toml, besides those of every board
  std::string_view kind;      // of the calibration, whose tables it loads (proto/CALIBRATION.md); empty: none
  std::unique_ptr<Stage> (*make)(const StageContext&) = nullptr;  // null: FramePath runs it
};

[[nodiscard]] std::span<const StageEntry> stage_table();

// Makers, each in stages/<name>/.
using StagePointer = std::unique_ptr<Stage>;
[[nodiscard]] StagePointer make_wrench(const StageContext& context);
[[nodiscard]] StagePointer make_feature_wrench(const StageContext& context);
[[nodiscard]] StagePointer make_contacts(const StageContext& context);
[[nodiscard]] StagePointer make_skin(const StageContext& context);
[[nodiscard]] StagePointer make_contact_model(const StageContext& context);
[[nodiscard]] StagePointer make_fingertip(const StageContext& context);
[[nodiscard]] StagePointer make_helmholtz(const StageContext& context);
[[nodiscard]] StagePointer make_contact_depth(const StageContext& context);

}  // namespace ruffini
