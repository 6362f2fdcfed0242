// Table of the stages (stages.cpp), in the order in which a board must list them.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/slots.h"
#include "core/stage.h"

namespace ruffini {

using StagePointer = std::unique_ptr<Stage>;

struct StageEntry {
  std::string_view name;  // in [pipeline] stages of board.toml
  SlotSet reads;          // the stage runs only if earlier stages write all of these
  SlotSet reads_if_written;
  bool needs_one = false;  // the board must write at least one of these
  SlotSet writes;
  SlotSet amends;             // slots of another stage that it modifies
  std::string_view sections;  // of board.toml, in addition to those of every board
  std::string_view kind;      // kind of the calibration whose tables it loads (proto/CALIBRATION.md); empty: none
  // Not listed by a board: runs here as part of this stage, and its time counts for that stage
  std::string_view part_of;
  // Changes the rest image, with which the stages before compare the next picture
  bool amends_rest = false;
  FeatureSort features{};  // of the slot kFeatures, if it writes that
  StagePointer (*make)(const StageContext&) = nullptr;
};

[[nodiscard]] std::span<const StageEntry> stage_table();
// Returns the row of the stage with this name in board.toml; the table's size if there is none.
[[nodiscard]] size_t stage_row(std::string_view name);
// Names that a board may list, in this order.
[[nodiscard]] std::vector<std::string> stage_names();
// True if one of the listed stages reads this section of board.toml.
[[nodiscard]] bool is_section_read(std::span<const std::string> stages, std::string_view section);
// Segments of the listed stages, in order: each can run for a frame while those before it run for the next frame. A
// segment ends where no stage so far depends on a later one through the previous frame, and where the slots so far are
// some that can be handed over (core/hand_over.h). Returns for each row of the table its segment, below kMaxSegments.
[[nodiscard]] std::vector<size_t> segments_of(std::span<const std::string> stages);
// Returns why a board may not list these stages, in one sentence; empty if it may.
[[nodiscard]] std::string refuse_stages(std::span<const std::string> stages);

}  // namespace ruffini
