#include "core/pipeline.h"

#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <string>
#include <vector>

#include "frame_calibration.h"
#include "frame_path.h"
#include "support/calibration_bytes.h"
#include "support/scenes.h"
#include "support/texture_calibration.h"

namespace ruffini {
namespace {

uint64_t ticking_clock() {
  static uint64_t now_ns = 0;
  return now_ns += 10;
}

class PipelineTest : public testing::Test {
 protected:
  void load(bool with_tables, SlotSet written) {
    file_ = CalibrationFile::load(test::contact_calibration(board_)).value();
    ASSERT_TRUE(pipeline_.load(with_tables ? &file_->get() : nullptr, written));
  }
  [[nodiscard]] uint64_t time_of(const char* stage) const { return now_.stage_ns[stage_row(stage)]; }

  // The markers are the test's, not a picture's.
  static BoardSettings board_of_given_markers() {
    BoardSettings board = test::contact_board();
    std::erase(board.stages, "difference");
    std::erase(board.stages, "markers");
    return board;
  }

  BoardSettings board_ = board_of_given_markers();
  FrameState state_;
  Frame now_{};
  std::vector<Marker> markers_ = std::vector<Marker>(static_cast<size_t>(board_.markers.lattice.count()));
  std::shared_ptr<const CalibrationFile> file_;
  Rest rest_{board_.camera.width_px, board_.camera.height_px, 1};
  Pipeline pipeline_{board_, rest_, state_, ticking_clock};

  PipelineTest() {
    state_.markers.marker = markers_;
    state_.features.sort.name = "markers";
    state_.features.value.resize(2 * markers_.size());
  }
};

TEST_F(PipelineTest, WithoutTablesRunsOnlyWhatNeedsNone) {
  load(false, {Slot::kMarkers, Slot::kFeatures});
  EXPECT_FALSE(pipeline_.writes(Slot::kWrench));
  EXPECT_TRUE(pipeline_.writes(Slot::kProfile));
  EXPECT_FALSE(pipeline_.writes(Slot::kContactModel));
  EXPECT_TRUE(pipeline_.writes(Slot::kHelmholtz));
  EXPECT_FALSE(pipeline_.writes(Slot::kDepth)) << "of a contact that no model describes";
  pipeline_.run(0, now_);
  EXPECT_EQ(time_of("feature_wrench"), 0U);
  EXPECT_EQ(time_of("contact_model"), 10U);
  EXPECT_EQ(time_of("helmholtz"), 10U);
  EXPECT_EQ(time_of("contact_depth"), 0U);
}

TEST_F(PipelineTest, WithTablesRunsEveryStageOfTheBoard) {
  load(true, {Slot::kMarkers, Slot::kFeatures});
  for (const Slot slot : {Slot::kWrench, Slot::kContactModel, Slot::kContacts, Slot::kDepth}) {
    EXPECT_TRUE(pipeline_.writes(slot)) << static_cast<int>(slot);
  }
  EXPECT_FALSE(pipeline_.writes(Slot::kSkin)) << "not a stage of this board";
}

TEST_F(PipelineTest, RunsFromASlotWhatDependsOnIt) {
  load(true, {Slot::kMarkers, Slot::kFeatures});
  pipeline_.run_from(Slot::kWrench, now_);
  EXPECT_EQ(time_of("feature_wrench"), 0U) << "it writes the wrench, and does not read it";
  EXPECT_EQ(time_of("contact_model"), 10U);
  EXPECT_EQ(time_of("contact_depth"), 10U) << "through the model";
}

TEST_F(PipelineTest, AStageWhoseInputNobodyWritesIsNotRun) {
  board_.stages = {"wrench", "contacts"};
  Pipeline without(board_, rest_, state_, ticking_clock);
  ASSERT_TRUE(without.load(nullptr, {Slot::kDisplacement}));
  EXPECT_FALSE(without.writes(Slot::kWrench));
  EXPECT_FALSE(without.writes(Slot::kContacts));
  Pipeline with(board_, rest_, state_, ticking_clock);
  ASSERT_TRUE(with.load(nullptr, {Slot::kDisplacement, Slot::kNodeForces}));
  EXPECT_TRUE(with.writes(Slot::kWrench));
  EXPECT_TRUE(with.writes(Slot::kContacts));
}

TEST_F(PipelineTest, AContactModelWithoutAWrenchIsRefused) {
  test::CalibrationBytes file;
  file_ = CalibrationFile::load(file.meta("kinds", "contact_model").bytes()).value();
  const Status loaded = pipeline_.load(&file_->get(), {Slot::kMarkers});
  ASSERT_FALSE(loaded);
  EXPECT_NE(loaded.error().message.find("contact_model without wrench"), std::string::npos);
}

// Forces x, y, z of all nodes: noise on a dent that is held, with [contact] steady_frames, each frame judged with
// `flags`.
std::vector<int32_t> held_dent(int steady_frames, uint32_t flags) {
  BoardSettings board = test::dots().board;
  board.contact.steady_frames = steady_frames;
  const std::shared_ptr<const CalibrationFile> file = CalibrationFile::load(test::diagonal_calibration(board)).value();
  FrameState state = FramePath::configure(board, file, ticking_clock).value()->state();
  Rest rest(board.camera.width_px, board.camera.height_px, 1);
  Pipeline pipeline(board, rest, state, ticking_clock);
  EXPECT_TRUE(pipeline.load(&file->get()));
  std::mt19937 random(7);
  std::vector<int32_t> out;
  const auto n_x = static_cast<size_t>(board.grid.n_x);
  const auto steps = [](int value) { return DisplacementUm::from_raw(static_cast<int16_t>(value)); };
  for (int t = 0; t < 8; ++t) {
    for (size_t i = 0; i < state.displacement.node.size(); ++i) {
      const bool is_pressed = i / n_x / 3 == 2 && i % n_x / 3 == 2;  // 3 x 3 nodes
      const int noise = static_cast<int>(random() % 3) - 1;
      state.displacement.node[i] = {steps(noise), steps(-noise), steps((is_pressed ? -2'000 : 0) + noise)};
    }
    Frame given{.is_measured = false, .is_displacement_given = true};
    pipeline.enter(0, given);
    pipeline.run_from(Slot::kDisplacement, given);
    uint32_t judged = flags;
    pipeline.judge(judged);
    for (const NodeForce& f : state.solve.force) out.insert(out.end(), {f.x, f.y, f.z});
  }
  return out;
}

TEST(Averaging, BeginsAgainAfterAFrameThatIsFlaggedOnceItIsSolved) {
  const auto each = held_dent(1, 0);
  EXPECT_NE(held_dent(8, 0), each);
  EXPECT_EQ(held_dent(8, kFlagFeatures), each) << "the camera has moved";
  EXPECT_NE(held_dent(8, kFlagRestUnverified), each) << "which spoils no force";
}

}  // namespace
}  // namespace ruffini
