// THE data path: one frame in, forces out. frame_path.cpp reads top to bottom.
//
// A FramePath belongs to one sensor and one thread. configure() allocates; process() does not.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "base/result.h"
#include "core/pipeline.h"
#include "core/slots.h"
#include "estimators/depth_gauge.h"
#include "estimators/force_field.h"
#include "estimators/marker_depth.h"
#include "estimators/zero_follower.h"
#include "frame_calibration.h"
#include "image/camera_map.h"
#include "image/light.h"
#include "image/picture_watch.h"
#include "image/poisson.h"
#include "image/printed_markers.h"
#include "image/rest.h"
#include "image/rest_watch.h"
#include "image/targets.h"
#include "image/texture_flow.h"
#include "image/views.h"
#include "store/calibration.h"

namespace ruffini {

class FramePath {
 public:
  // `calibration` may be null: then forces are not measured. Errors: kBadInput, kRefused.
  [[nodiscard]] static Result<std::unique_ptr<FramePath>> configure(const BoardSettings& board,
                                                                    std::shared_ptr<const CalibrationFile> calibration,
                                                                    ClockFunction clock);

  // Precondition: frame has the board's size. Valid until the next call. Capture time 0: without the pad's relaxation.
  const FrameState& process(const FrameView& frame, uint64_t capture_us = 0);

  // From the next frame on; empty: not measured.
  void set_temperature(std::optional<int32_t> milli_celsius) { warmth_.now_mc = milli_celsius; }
  // Frames of a camera, not of a file: watched (image/picture_watch.h), creep followed (estimators/zero_follower.h).
  void set_live(bool is_live) { is_live_ = is_live; }
  // Flags that the next frames have by the way they came: kFlagTime or none.
  void set_capture_flags(uint32_t flags) { capture_flags_ = flags; }
  // Learn rest anew from n frames (0 = the board's own number); watched: not where one of them shows a press.
  void zero(int n_frames, bool is_watched = true);
  // The camera stood still meanwhile, and what came onto the pad is not known: rest is what it was.
  void give_up_zero() { rest_.give_up(); }
  // Before the first frame: rest as another run knew it, or empty. The start is watched as a zero is, or unverified.
  void expect_rest(std::span<const uint16_t> known);
  [[nodiscard]] const RestWatch& rest_watch() const { return rest_watch_; }
  [[nodiscard]] bool is_zeroing() const { return rest_.is_learned_anew(); }
  void set_rest(std::span<const uint16_t> image);
  // Copies the rest image of another path, or what it knows of rest while it learns; and its temperature.
  void take_rest(const FramePath& other);
  // The solve alone: displacement -> force. For offline use.
  void solve(std::span<const NodeDisplacement> displacement);
  // Where somebody asks: what the frame's forces leave unexplained, into its state. Its time is the second pass's, too.
  void find_residual();

  [[nodiscard]] const FrameState& state() const { return state_; }
  [[nodiscard]] std::span<const Marker> markers() const { return flow_ ? flow_->markers() : printed_.markers(); }
  [[nodiscard]] std::span<const Target> targets() const { return targets_.targets(); }
  [[nodiscard]] bool has_targets() const { return has(StageId::kTargets) && !targets().empty(); }
  [[nodiscard]] const std::optional<ViewMaps>& views() const { return views_; }
  [[nodiscard]] bool are_markers_graded() const { return has(StageId::kMarkers); }
  [[nodiscard]] bool has_rest() const { return rest_.is_ready(); }
  [[nodiscard]] bool is_touched() const;  // by the last frame something presses on the pad
  [[nodiscard]] const ZeroFollower& zero_follower() const { return zero_follower_; }
  void set_calibration_id(uint32_t id) { calibration_id_ = id; }  // what this path computes with, for stamps; 0: none
  [[nodiscard]] uint32_t calibration_id() const { return calibration_id_; }
  [[nodiscard]] std::span<const uint16_t> rest_image() const { return rest_.image(); }
  [[nodiscard]] const BoardSettings& board() const { return board_; }
  [[nodiscard]] const NodeGrid& nodes() const { return nodes_; }
  // Some stage of this board writes the slot, and the calibration has the tables that it needs.
  [[nodiscard]] bool writes(Slot slot) const { return pipeline_.writes(slot); }
  [[nodiscard]] int n_markers_at_rest() const { return state_.markers.n_at_rest; }

 private:
  FramePath(const BoardSettings& board, std::shared_ptr<const CalibrationFile> calibration, ClockFunction clock);
  // frame_path_tables.cpp
  Status load_tables();
  Status load_camera_map(const Calibration& c);
  Status load_photometric(const Calibration& c);
  [[nodiscard]] SlotSet written() const;
  [[nodiscard]] bool has_gauge() const { return !board_.depth.has_gauge_table() || depth_gauge_; }
  [[nodiscard]] bool light_is_trusted() const;
  [[nodiscard]] bool depth_is_trusted() const { return marker_depth_ || light_is_trusted(); }
  [[nodiscard]] bool has(StageId stage) const { return is_on_[static_cast<size_t>(stage)]; }

  // What hides the surface, and tells whether the pad is at rest.
  [[nodiscard]] std::span<const Marker> hidden() const { return target_marks_.empty() ? markers() : target_marks_; }
  void forget();
  void learn(const FrameView& frame);
  void learn_watched(const FrameView& frame);
  void verify_rest();
  void measure(const FrameView& frame, uint64_t capture_us);
  void learn_features();
  void learn_markers();
  void run_difference(const FrameView& frame);
  void make_grey(const FrameView& frame);
  void run_markers(const FrameView& frame);
  void run_targets();
  void follow_light();
  void run_depth();
  void run_displacement();
  void run_solve(bool with_second_pass);
  void run_memory(uint64_t capture_us);
  void run_uncertainty();
  void publish_markers();
  [[nodiscard]] Frame frame_of(const FrameView& view, uint64_t capture_us);
  // frame_path_verdict.cpp
  [[nodiscard]] bool presses(uint32_t flags) const;
  void watch(const FrameView& frame);
  void follow_zero(uint64_t capture_us);
  void judge_input();
  bool are_markers_lost();
  void judge();
  [[nodiscard]] bool is_wrong() const;
  template <typename Work>
  void timed(StageId stage, Work work);

  BoardSettings board_;
  std::shared_ptr<const CalibrationFile> calibration_;
  ClockFunction clock_;
  std::array<bool, kStageCount> is_on_{};
  NodeGrid nodes_;
  Rest rest_;
  RestWatch rest_watch_;
  PictureWatch picture_watch_;
  bool is_live_ = false;
  uint32_t capture_flags_ = 0;
  ZeroFollower zero_follower_;  // of the nodes' displacement
  LightTracker light_;          // where colours become depth
  int n_drifting_ = 0;          // frames in a row, up to kDriftFrames
  bool is_light_steady_ = true;
  PrintedMarkers printed_;
  std::optional<TextureFlow> flow_;  // in place of the printed ones where the board's markers are patches of a texture
  bool is_other_pad_ = false;
  TargetTracker targets_;
  std::vector<Marker> target_marks_;  // targets as what hides the surface
  std::optional<CameraMap> camera_map_;
  std::optional<ViewMaps> views_;
  std::optional<Photometric> photometric_;
  bool is_foreign_optics_ = false;
  Poisson poisson_;
  Displacement displacement_;
  std::optional<DepthGauge> depth_gauge_;    // of boards whose gauge is a table
  std::optional<MarkerDepth> marker_depth_;  // of boards whose depth comes from the markers
  ForceField forces_;
  Warmth warmth_;
  uint32_t calibration_id_ = 0;
  SaturationCounter untrusted_saturations_;  // of a depth that no force is made of
  FrameState state_;
  Pipeline pipeline_;  // of the stages that have a room of their own
};

}  // namespace ruffini
