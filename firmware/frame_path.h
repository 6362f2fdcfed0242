// The life of a frame: one frame in, forces out. The board's stages run in core/pipeline; here are rest and its watch, the
// watch on the picture, and the flags of a frame.
//
// A FramePath belongs to one sensor and one thread. configure() allocates; process() does not.
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
  void cancel_zero() { rest_.cancel_learning(); }
  // Before the first frame: rest as another run knew it, or empty. The start is watched as a zero is, or unverified.
  void expect_rest(std::span<const uint16_t> known);
  [[nodiscard]] const RestWatch& rest_watch() const { return rest_watch_; }
  [[nodiscard]] bool is_zeroing() const { return rest_.is_relearning(); }
  void set_rest(std::span<const uint16_t> image);
  // Copies the rest image of another path, or what it knows of rest while it learns; and its temperature.
  void take_rest(const FramePath& other);
  // The solve alone: displacement -> force. For offline use.
  void solve(std::span<const NodeDisplacement> displacement);
  // Where somebody asks: what the frame's forces leave unexplained, into its state. Its time is the second pass's, too.
  void compute_residual();

  [[nodiscard]] const FrameState& state() const { return state_; }
  [[nodiscard]] std::span<const Marker> markers() const { return state_.markers.marker; }
  [[nodiscard]] std::span<const Target> targets() const { return state_.targets.target; }
  [[nodiscard]] bool has_targets() const { return !targets().empty(); }
  [[nodiscard]] bool has_marker_quality() const { return writes(Slot::kMarkers); }
  [[nodiscard]] bool has_rest() const { return rest_.is_ready(); }
  [[nodiscard]] bool is_touched() const;                          // by the last frame something presses on the pad
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
  Status load_tables();

  void learn(const FrameView& frame);
  void learn_watched(const FrameView& frame);
  void learn_features();
  void verify_rest();
  void watch(const FrameView& frame);
  void measure(const FrameView& frame, uint64_t capture_us);
  [[nodiscard]] Frame frame_of(const FrameView& view, uint64_t capture_us);
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
  NodeRepair repair_;  // of given displacements
  bool is_live_ = false;
  uint32_t capture_flags_ = 0;
  Warmth warmth_;
  uint32_t calibration_id_ = 0;
  FrameState state_;
  Pipeline pipeline_;
};

}  // namespace ruffini
