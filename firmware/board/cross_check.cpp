#include "board/cross_check.h"

#include <algorithm>
#include <bit>
#include <set>

#include "core/stages.h"

namespace ruffini {
namespace {

bool has_stage(const BoardSettings& board, const char* name) {
  return std::find(board.stages.begin(), board.stages.end(), name) != board.stages.end();
}

void check_views(BoardReader& in, const BoardSettings& board) {
  const MarkerSettings& markers = board.markers;
  if (!markers.places.empty()) return in.fail("markers.places_um needs markers.layout = \"scattered\"");
  if (board.camera.width_px % markers.lattice.n_y != 0) {
    return in.fail("camera.width_px is no multiple of the markers.n_y views that it holds");
  }
  if (has_stage(board, "displacement") || has_stage(board, "photometric")) {
    in.fail("markers.layout views has no nodes: leave the stages displacement and photometric out");
  }
}

void check_scattered(BoardReader& in, const BoardSettings& board) {
  const MarkerSettings& markers = board.markers;
  if (markers.polarity == Polarity::kTexture) return in.fail("markers.polarity texture needs markers.layout lattice");
  if (markers.has_views) return check_views(in, board);
  if (markers.places.empty()) return;
  if (std::ssize(markers.places) != markers.lattice.count()) {
    return in.fail("markers.places_um lists " + std::to_string(markers.places.size()) +
                   " places, but n_x times n_y is " + std::to_string(markers.lattice.count()));
  }
  std::set<std::pair<int64_t, int64_t>> different;
  for (const PadPlace& at : markers.places) {
    different.insert({at.x_um, at.y_um});
    if (at.x_um > board.pad.size_x_um || at.y_um > board.pad.size_y_um) {
      return in.fail("markers.places_um reaches beyond the pad");
    }
  }
  if (different.size() != markers.places.size()) in.fail("markers.places_um lists a place twice");
}

void check_markers(BoardReader& in, const BoardSettings& board) {
  const MarkerSettings& markers = board.markers;
  if (markers.lattice.count() == 0) return;
  if (markers.is_scattered) {
    check_scattered(in, board);
  } else if (!markers.places.empty()) {
    in.fail("markers.places_um needs markers.layout = \"scattered\"");
  } else if (markers.first_x_um + (markers.lattice.n_x - 1) * markers.pitch_x_um > board.pad.size_x_um ||
             markers.first_y_um + (markers.lattice.n_y - 1) * markers.pitch_y_um > board.pad.size_y_um) {
    in.fail("[markers] lattice reaches beyond the pad");
  }
  if (markers.diameter_um >= markers.pitch_x_um || markers.diameter_um >= markers.pitch_y_um) {
    in.fail("markers.diameter_um must be below the pitch");
  }
  if (markers.polarity != Polarity::kTexture) return;
  if (has_stage(board, "photometric")) {
    in.fail("markers.polarity texture leaves no shading to the stage photometric: leave one of them out");
  }
  if (std::min(board.camera.width_px, board.camera.height_px) < 64) {  // TextureFlow::kMinSizePx
    in.fail("markers.polarity texture needs an image of at least 64 x 64 pixels");
  }
}

void check_gauge(BoardReader& in, const BoardSettings& board) {
  if (!board.depth.has_gauge_table()) return;
  if (!has_stage(board, "poisson") || !has_stage(board, "displacement")) {
    in.fail("depth.gauge spacing, volume and both need the stages poisson and displacement");
  } else if (board.markers.is_scattered) {
    in.fail("depth.gauge spacing, volume and both need markers.layout lattice");
  }
}

void check_depth(BoardReader& in, const BoardSettings& board) {
  if (board.depth.source == DepthSource::kLight) return;
  if (!has_stage(board, "displacement")) {
    in.fail("depth.source markers needs the stage displacement");
  } else if (has_stage(board, "photometric") || has_stage(board, "poisson")) {
    in.fail("depth.source markers takes no depth from light: leave the stages photometric and poisson out");
  } else if (board.markers.is_scattered) {
    in.fail("depth.source markers needs markers.layout lattice");
  }
}

void check_targets(BoardReader& in, const BoardSettings& board) {
  const TargetSettings& targets = board.targets;
  if (targets.places.empty()) return;
  if (std::ssize(targets.places) > 16) in.fail("targets.places_um lists more than 16 places");
  for (const PadPlace& at : targets.places) {
    if (at.x_um > board.pad.size_x_um || at.y_um > board.pad.size_y_um) {
      in.fail("targets.places_um reaches beyond the pad");
    }
  }
  const int64_t distance_um = board.camera.standoff_um - targets.below_um;
  if (distance_um <= 0) return in.fail("targets.below_um is not in front of the camera");
  const int64_t radius_px = targets.diameter_um * board.camera.focal_mpx / (2'000 * distance_um);
  if (radius_px < 16 || radius_px > 200) {  // DiscEdge::kMinRadiusPx, kMaxRadiusPx
    in.fail("targets.diameter_um makes a radius of " + std::to_string(radius_px) +
            " px in the image: 16 to 200 can be measured");
  }
}

// The corners go round with the clock, and no angle is a straight line.
void check_picture_features(BoardReader& in, const BoardSettings& board) {
  const std::vector<PicturePlace>& corners = board.picture_features.corners;
  if (board.picture_features.cells.count() == 0) return;
  if (corners.size() != 4) return in.fail("picture_features.corners_px must list four corners of the gel");
  for (size_t i = 0; i < corners.size(); ++i) {
    const PicturePlace& a = corners[i];
    const PicturePlace& b = corners[(i + 1) % 4];
    const PicturePlace& c = corners[(i + 2) % 4];
    if (a.x_px >= board.camera.width_px || a.y_px >= board.camera.height_px) {
      return in.fail("picture_features.corners_px reaches beyond the picture");
    }
    if ((b.x_px - a.x_px) * (c.y_px - b.y_px) <= (b.y_px - a.y_px) * (c.x_px - b.x_px)) {
      return in.fail(
          "picture_features.corners_px must go round a convex gel: top left, top right, bottom right, bottom left");
    }
  }
}

// Spots are brighter than their ground, at known places.
void check_spots(BoardReader& in, const BoardSettings& board) {
  if (!has_stage(board, "spot_intensities")) return;
  const MarkerSettings& markers = board.markers;
  if (markers.polarity != Polarity::kLight) return in.fail("stage spot_intensities needs markers.polarity light");
  if (markers.is_scattered && markers.places.empty()) {
    in.fail("stage spot_intensities needs the spots' places: markers.places_um, or layout lattice");
  }
}

void check_flow(BoardReader& in, const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  const int64_t most = 4;  // Helmholtz::kMaxOblong
  if (has_stage(board, "contact_model") && m.polarity != Polarity::kTexture) {
    in.fail("stage contact_model needs markers.polarity texture");
  } else if (has_stage(board, "helmholtz") &&
             (m.pitch_x_um > most * m.pitch_y_um || m.pitch_y_um > most * m.pitch_x_um)) {
    in.fail("stage helmholtz needs markers.pitch_x_um and pitch_y_um within four times each other");
  } else if (has_stage(board, "fingertip") && (!m.has_views || m.lattice.n_y != 2)) {
    in.fail("stage fingertip needs markers.layout views with n_y 2");
  }
}

void check_skin(BoardReader& in, const BoardSettings& board) {
  const SkinSettings& skin = board.skin;
  const int64_t weights = skin.weights[0] + skin.weights[1] + skin.weights[2];
  if (weights == 0 && skin.level == 0) return;
  if (weights < 1 || weights > 8) in.fail("[skin] weights must sum to 1 to 8");
  if ((skin.shape == SkinShape::kPlane) != (skin.radius_um == 0)) {
    in.fail("skin.radius_um must be 0 for a plane and above 0 for a tube or a dome");
  }
}

void check_cores(BoardReader& in, const BoardSettings& board) {
  if (board.n_cores == 1) return;
  const std::vector<size_t> segments = segments_of(board.stages);
  if (segments.back() == 0) {
    in.fail("pipeline.cores = 2 has no stage here that can run beside the next picture: take 1");
  } else if (std::popcount(board.threads.frame.cpus) == 1) {
    in.fail("pipeline.cores = 2 needs two cores in threads.frame_cpus, or none");
  }
}

}  // namespace

void cross_check(BoardReader& in, const BoardSettings& board) {
  if (const std::string refused = refuse_stages(board.stages); !refused.empty()) return in.fail(refused);
  const WindowSettings& window = board.window;
  if (window.max_x_um > board.pad.size_x_um || window.max_y_um > board.pad.size_y_um) {
    in.fail("[window] reaches beyond the pad");
  } else if (window.min_x_um >= window.max_x_um || window.min_y_um >= window.max_y_um) {
    in.fail("[window] is empty: min must be below max");
  } else if (observed_nodes(board.grid.n_x, board.pad.size_x_um, window.min_x_um, window.max_x_um).count < 2 ||
             observed_nodes(board.grid.n_y, board.pad.size_y_um, window.min_y_um, window.max_y_um).count < 2) {
    in.fail("[window] holds fewer than 2 node lines: widen it or refine [grid]");
  }
  check_cores(in, board);
  check_markers(in, board);
  check_gauge(in, board);
  check_depth(in, board);
  check_skin(in, board);
  check_flow(in, board);
  check_targets(in, board);
  check_picture_features(in, board);
  check_spots(in, board);
  if (board.depth.step_px == 3 || board.camera.width_px % board.depth.step_px != 0 ||
      board.camera.height_px % board.depth.step_px != 0) {
    in.fail("depth.step_px must be 1, 2 or 4 and divide the image");
  }
  const int64_t widest_px = std::max(board.camera.width_px, board.camera.height_px);
  if (is_section_read(board.stages, "depth") && board.depth.step_px > 0 &&
      widest_px / board.depth.step_px > 640) {  // Poisson::kMaxCells
    in.fail("the depth grid has more than 640 cells: use a larger depth.step_px");
  }
  if (widest_px * 1000 * board.camera.standoff_um > 2'000'000 * board.camera.focal_mpx) {
    in.fail("[camera] sees more than 2 m of pad: check focal_mpx and standoff_um");
  }
  if (board.camera.center_x_mpx >= int64_t{1000} * board.camera.width_px ||
      board.camera.center_y_mpx >= int64_t{1000} * board.camera.height_px) {
    in.fail("[camera] center is outside the image");
  }
}

}  // namespace ruffini
