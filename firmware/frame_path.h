// Processes one camera frame to forces. The board's stages run in core/pipeline; this class owns the rest image and its
// checks, the checks on the picture, and the flags of a frame.
//
// A FramePath belongs to one sensor and one thread, or with [pipeline] cores = 2 to two frame threads: a frame passes
// the segments (core/stages.h) one after the other, and each holds one frame at a time. All functions but begin(),
// enter() and run() need a path without frames, or the last segment. configure() allocates; process() does not.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "base/result.h"
#include "core/pipeline.h"
#include "core/slots.h"
#include "estimators/node_repair.h"
#include "estimators/wrench.h"
#include "frame_calibration.h"
#include "image/picture_watch.h"
#include "image/rest.h"
#include "image/rest_watch.h"
#include "store/calibration.h"

namespace ruffini {

class FramePath {
 public:
  // `calibration` may be null: forces are not measured then. Errors: kBadInput, kRefused.
  [[nodiscard]] static Result<std::unique_ptr<FramePath>> configure(const BoardSettings& board,
                                                                    std::shared_ptr<const CalibrationFile> calibration,
                                                                    ClockFunction clock);

  // Precondition: frame has the board's size. The result is valid until the next call. capture_us = 0: the pad's
  // relaxation is ignored.
  const FrameState& process(const FrameView& frame, uint64_t capture_us = 0);

  // process() in its steps: begin() in the first segment, then in each segment enter(), after which the segment before
  // is free, and run(). state() is that of the frame that the last segment holds.
  [[nodiscard]] size_t n_segments() const { return pipeline_.n_segments(); }
  [[nodiscard]] Frame begin(const FrameView& view, uint64_t capture_us);
  void enter(size_t segment, const Frame& frame) { pipeline_.enter(segment, frame); }
  void run(size_t segment, Frame& frame);

  // Sets the pad's temperature from the next frame on; empty: not measured.
  void set_temperature(std::optional<int32_t> milli_celsius) { warmth_.now_mc = milli_celsius; }
  // Frames of a live camera are checked (image/picture_watch.h), and creep is followed (estimators/zero_follower.h).
  void set_live(bool is_live) { is_live_ = is_live; }
  // Flags that the capture adds to the next frames: kFlagTime or none.
  void set_capture_flags(uint32_t flags) { capture_flags_ = flags; }
  // Learns a new rest image from n frames (0: the board's number). Watched: cancelled if one of them shows contact.
  void zero(int n_frames, bool is_watched = true);
  // The camera stalled while zeroing: keeps the previous rest image.
  void cancel_zero() { rest_.cancel_learning(); }
  // Call before the first frame. `known`: rest image of a previous run, or empty. The start is then checked like a
  // zero, or else the rest image is unverified.
  void expect_rest(std::span<const uint16_t> known);
  [[nodiscard]] const RestWatch& rest_watch() const { return rest_watch_; }
  [[nodiscard]] bool is_zeroing() const { return rest_.is_relearning(); }
  void set_rest(std::span<const uint16_t> image);
  // Copies the rest image or the state of its learning, and the temperature, from another path.
  void take_rest(const FramePath& other);
  // Solve alone: displacement to force. For offline use.
  void solve(std::span<const NodeDisplacement> displacement);
  // Computes the residual of the frame's forces on request. Its time counts for the second pass.
  void compute_residual();

  [[nodiscard]] const FrameState& state() const { return state_; }
  [[nodiscard]] std::span<const Marker> markers() const { return state_.markers.marker; }
  [[nodiscard]] std::span<const Target> targets() const { return state_.targets.target; }
  [[nodiscard]] bool has_targets() const { return !targets().empty(); }
  [[nodiscard]] bool has_marker_quality() const { return writes(Slot::kMarkers); }
  [[nodiscard]] bool has_rest() const { return rest_.is_ready(); }
  [[nodiscard]] bool is_touched() const;                          // true if the last frame shows contact
  void set_calibration_id(uint32_t id) { calibration_id_ = id; }  // stamped on results; 0: no calibration
  [[nodiscard]] uint32_t calibration_id() const { return calibration_id_; }
  [[nodiscard]] std::span<const uint16_t> rest_image() const { return rest_.image(); }
  [[nodiscard]] const BoardSettings& board() const { return board_; }
  [[nodiscard]] const NodeGrid& nodes() const { return nodes_; }
  // True if a stage of this board writes the slot and the calibration has the tables that it needs.
  [[nodiscard]] bool writes(Slot slot) const { return pipeline_.writes(slot); }
  [[nodiscard]] int n_markers_at_rest() const { return state_.markers.n_at_rest; }

 private:
  FramePath(const BoardSettings& board, std::shared_ptr<const CalibrationFile> calibration, ClockFunction clock);
  Status load_tables();

  void learn(const FrameView& frame);
  void learn_watched(const FrameView& frame);
  void learn_features();
  void verify_rest();
  void watch(Frame& frame);
  void end(Frame& frame);
  void take_results(const Frame& frame);
  [[nodiscard]] bool is_touched_by_results() const;
  [[nodiscard]] bool presses(uint32_t flags) const;
  void judge();

  BoardSettings board_;
  std::shared_ptr<const CalibrationFile> calibration_;
  ClockFunction clock_;
  NodeGrid nodes_;
  Rest rest_;
  RestWatch rest_watch_;
  PictureWatch picture_watch_;
  NodeRepair repair_;  // for displacements given by a caller
  bool is_live_ = false;
  uint32_t capture_flags_ = 0;
  Warmth warmth_;
  uint32_t calibration_id_ = 0;
  FrameState state_;
  Pipeline pipeline_;
};

}  // namespace ruffini
