#include "core/stages.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "core/hand_over.h"
#include "estimators/wrench.h"
#include "support/texture_calibration.h"

namespace ruffini {
namespace {

TEST(StageTable, FindsARowByItsName) {
  for (const std::string& name : stage_names()) EXPECT_EQ(stage_table()[stage_row(name)].name, name);
  EXPECT_EQ(stage_row("uncertainty"), stage_table().size()) << "a part of support: no board lists it";
  EXPECT_EQ(stage_row("nothing"), stage_table().size());
}

TEST(StageTable, AStageTakesTheSlotsThatItDeclaresAndNoOthers) {
  const BoardSettings board = test::contact_board();
  for (const StageEntry& entry : stage_table()) {
    FrameState state;
    Rest rest(board.camera.width_px, board.camera.height_px, 1);
    state.solve.force.resize(static_cast<size_t>(NodeGrid(board).size().count()));
    SlotAccess slots(state);
    const auto stage = entry.make({board, slots, {}, false, rest});
    EXPECT_EQ(slots.all_read(), (entry.reads | entry.reads_if_written).without(entry.amends)) << entry.name;
    EXPECT_EQ(slots.all_written(), entry.writes) << entry.name;
    EXPECT_EQ(slots.all_amended(), entry.amends) << entry.name;
  }
}

TEST(StageTable, TheTestsBoardsHaveEveryStageInTurnAndNoTwoThatForbidEachOther) {
  std::set<std::string> listed;
  for (const std::vector<std::string>& stages : test::stages_by_turns()) {
    EXPECT_EQ(refuse_stages(stages), "");
    listed.insert(stages.begin(), stages.end());
  }
  for (const std::string& name : stage_names()) EXPECT_TRUE(listed.contains(name)) << name;
}

TEST(StageTable, APartBelongsToAStageThatABoardLists) {
  for (const StageEntry& entry : stage_table()) {
    if (entry.part_of.empty()) continue;
    EXPECT_LT(stage_row(entry.part_of), stage_table().size()) << entry.name;
  }
}

TEST(StageTable, EachWriterOfFeaturesStatesASortOfItsOwnWithItsUnit) {
  std::set<std::string_view> names;
  for (const StageEntry& entry : stage_table()) {
    EXPECT_EQ(entry.writes.has(Slot::kFeatures), !entry.features.name.empty()) << entry.name;
    if (entry.features.name.empty()) continue;
    EXPECT_TRUE(names.insert(entry.features.name).second) << entry.name;
    EXPECT_FALSE(std::string_view(entry.features.unit).empty()) << entry.name;
  }
}

TEST(StageTable, SlotsHaveNamesOfTheirOwn) {
  std::set<std::string_view> names;
  for (size_t i = 0; i < kSlotCount; ++i) names.insert(slot_name(static_cast<Slot>(i)));
  EXPECT_EQ(names.size(), kSlotCount);
  EXPECT_EQ(slot_name(Slot::kToolTouch), "tool_touch");
}

TEST(StageTable, WhatAStageMustReadIsWrittenBeforeIt) {
  SlotSet written;
  for (const StageEntry& entry : stage_table()) {
    EXPECT_TRUE(written.has_all(entry.reads)) << entry.name;
    written = written | entry.writes;
  }
}

using Stages = std::vector<std::string>;

TEST(Refusal, NamesTheStagesThatWriteWhatIsMissing) {
  EXPECT_EQ(refuse_stages(Stages{"difference", "markers", "displacement", "operator"}), "");
  EXPECT_EQ(refuse_stages(Stages{"difference", "markers", "operator"}), "stage operator needs the stage displacement");
  EXPECT_EQ(refuse_stages(Stages{"markers"}), "stage markers needs the stage difference");
  const std::string said = refuse_stages(Stages{"feature_wrench"});
  EXPECT_EQ(said.find("stage feature_wrench needs the stage markers, targets"), 0U) << said;
  for (const StageEntry& entry : stage_table()) {
    if (!entry.writes.has(Slot::kFeatures)) continue;
    EXPECT_NE(said.find(std::string(entry.name)), std::string::npos) << said;
  }
  EXPECT_EQ(said.find("photometric"), std::string::npos) << said;
}

TEST(Refusal, NamesTwoWritersOfASlot) {
  EXPECT_EQ(refuse_stages(Stages{"difference", "markers", "displacement", "operator", "wrench", "feature_wrench"}),
            "stages wrench and feature_wrench both write the slot wrench: leave one of them out");
}

TEST(Refusal, NamesTheOrder) {
  for (const Stages& stages : {Stages{}, Stages{"markers", "difference"}, Stages{"skin", "skin"}, Stages{"light"}}) {
    const std::string said = refuse_stages(stages);
    EXPECT_EQ(said.find("pipeline.stages must be some of difference, markers, targets, "), 0U) << said;
    EXPECT_NE(said.find(", photometric, poisson, "), std::string::npos) << said;
  }
}

TEST(Refusal, SectionsAreThoseOfTheListedStages) {
  EXPECT_TRUE(is_section_read(Stages{"operator"}, "grid"));
  EXPECT_FALSE(is_section_read(Stages{"skin"}, "grid"));
  EXPECT_FALSE(is_section_read(Stages{"operator"}, "gri"));
}

// The listed stages, "|" between two segments.
std::string segments_in(const Stages& stages) {
  const std::vector<size_t> segment_of = segments_of(stages);
  std::string out;
  size_t segment = 0;
  for (const std::string& stage : stages) {
    out += segment_of[stage_row(stage)] == segment ? " " : " | ";
    segment = segment_of[stage_row(stage)];
    out += stage;
  }
  return out;
}

TEST(Segments, EndWhereNoStageDependsOnALaterOneThroughThePreviousFrame) {
  EXPECT_EQ(segments_in({"difference", "markers", "photometric", "poisson", "displacement", "operator", "support",
                         "wrench", "contacts"}),
            " difference markers photometric | poisson | displacement | operator support wrench contacts");
  EXPECT_EQ(segments_in({"difference", "picture_features", "feature_wrench", "softness"}),
            " difference picture_features | feature_wrench softness");
  EXPECT_EQ(segments_in({"difference", "markers", "fingertip", "vibration"}),
            " difference markers | fingertip vibration");
  EXPECT_EQ(segments_in({"skin"}), " skin");
}

TEST(Segments, BeforeTheLastOneWriteOnlyWhatCanBeHandedOver) {
  for (const std::vector<std::string>& stages : test::stages_by_turns()) {
    const std::vector<size_t> segment_of = segments_of(stages);
    EXPECT_LT(segment_of.back(), kMaxSegments);
    EXPECT_TRUE(std::is_sorted(segment_of.begin(), segment_of.end()));
    for (size_t row = 0; row < segment_of.size(); ++row) {
      const StageEntry& entry = stage_table()[row];
      const std::string_view listed = entry.part_of.empty() ? entry.name : entry.part_of;
      if (std::find(stages.begin(), stages.end(), listed) == stages.end()) continue;
      const bool can_leave = kHandedOver.has_all(entry.writes | entry.amends);
      EXPECT_TRUE(can_leave || segment_of[row] == segment_of.back()) << entry.name;
    }
  }
}

TEST(SlotSet, HoldsWhatWasAdded) {
  SlotSet set = {Slot::kWrench, Slot::kSkin};
  EXPECT_TRUE(set.has(Slot::kWrench));
  EXPECT_FALSE(set.has(Slot::kContacts));
  EXPECT_TRUE(set.has_all({Slot::kSkin}));
  EXPECT_FALSE(set.has_all({Slot::kSkin, Slot::kContacts}));
  EXPECT_TRUE(set.has_any({Slot::kSkin, Slot::kContacts}));
  EXPECT_FALSE(set.has_any({Slot::kContacts}));
  set.add(Slot::kContacts);
  EXPECT_EQ(set, (SlotSet{Slot::kSkin, Slot::kContacts, Slot::kWrench}));
  EXPECT_EQ(set & SlotSet({Slot::kSkin, Slot::kDepth}), SlotSet{Slot::kSkin});
}

}  // namespace
}  // namespace ruffini
