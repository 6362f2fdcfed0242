#include "core/stages.h"

#include <gtest/gtest.h>

#include "support/texture_calibration.h"

namespace ruffini {
namespace {

TEST(StageTable, NamesAreTheKnownOnesInTheirOrder) {
  ASSERT_EQ(stage_table().size(), known_stages().size());
  for (size_t i = 0; i < known_stages().size(); ++i) EXPECT_EQ(stage_table()[i].name, known_stages()[i]);
}

TEST(StageTable, AStageTakesTheSlotsThatItDeclaresAndNoOthers) {
  const BoardSettings board = test::contact_board();
  size_t n_made = 0;
  for (const StageEntry& entry : stage_table()) {
    if (entry.make == nullptr) continue;
    FrameState state;
    SlotAccess slots(state);
    const auto stage = entry.make({board, slots});
    EXPECT_EQ(slots.all_read(), entry.reads | entry.reads_if_written) << entry.name;
    EXPECT_EQ(slots.all_written(), entry.writes) << entry.name;
    ++n_made;
  }
  EXPECT_EQ(n_made, 8U);
}

TEST(StageTable, WhatAStageMustReadIsWrittenBeforeIt) {
  SlotSet written;
  for (const StageEntry& entry : stage_table()) {
    EXPECT_TRUE(written.has_all(entry.reads)) << entry.name;
    written = written | entry.writes;
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
