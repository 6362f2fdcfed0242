// What a path is made of before its first frame: the calibration's tables, checked against the board.
#include <algorithm>
#include <cstring>
#include <utility>

#include "frame_path.h"

namespace ruffini {

// Depth and nodes are then computed in the view of the map's ideal pinhole.
Status FramePath::load_camera_map(const Calibration& c) {
  if (!c.has_kind("camera")) return Unit{};
  if (Status map = keep(CameraMap::load(c, board_), camera_map_); !map) return map;
  poisson_ = Poisson(camera_map_->ideal_board());
  displacement_ = Displacement(camera_map_->ideal_board(), &*camera_map_);
  return Unit{};
}

Status FramePath::load_photometric(const Calibration& c) {
  if (!has(StageId::kPhotometric) || !c.has_kind("photometric")) return Unit{};
  const auto table = PhotometricTable::load(c);
  if (!table) return table.error();
  photometric_.emplace(board_, table.value());
  is_foreign_optics_ = c.text("optics") != board_.camera.optics;
  return Unit{};
}

// Slots of the stages that have no room of their own yet.
SlotSet FramePath::written() const {
  SlotSet out;
  for (const StageEntry& stage : stage_table()) {
    const bool is_ours =
        stage.make == nullptr && std::count(board_.stages.begin(), board_.stages.end(), stage.name) > 0;
    if (is_ours && (!stage.writes.has(Slot::kNodeForces) || forces_.is_measured())) out = out | stage.writes;
  }
  return out;
}

// Which tables the calibration brings, and whether they fit this board.
Status FramePath::load_tables() {
  const Calibration* calibration = calibration_ ? &calibration_->get() : nullptr;
  if (calibration == nullptr) return pipeline_.load(nullptr, written());
  const Calibration& c = *calibration;
  if (std::ssize(calibration_->bytes()) > board_.calibration_kb * 1024) {
    return Error{ErrorKind::kBadInput, "calibration file: larger than the " + std::to_string(board_.calibration_kb) +
                                           " kB of [memory] calibration_kb: make one with fewer nodes"};
  }
  const auto picture = [&](const char* name) {
    return c.tensor(name, Tensor::Type::kU16, {board_.camera.height_px, board_.camera.width_px, 3});
  };
  if (c.has_kind("dark")) {
    const auto dark = picture("dark.image");
    if (!dark) return dark.error();
    rest_.set_dark(dark.value()->as<uint16_t>());
  }
  if (Status camera = load_camera_map(c); !camera) return camera;
  if (c.has_kind("views")) {
    if (Status views = keep(ViewMaps::load(c, board_), views_); !views) return views;
  }
  if (Status light = load_photometric(c); !light) return light;
  if (board_.depth.has_gauge_table() && c.has_kind("gauge")) {
    if (Status gauge = keep(DepthGauge::load(c, board_), depth_gauge_); !gauge) return gauge;
  }
  if (board_.depth.source == DepthSource::kMarkers && c.has_kind("marker_depth")) {
    if (Status depth = keep(MarkerDepth::load(c, board_), marker_depth_); !depth) return depth;
  }
  if (Status forces = forces_.load(c, has(StageId::kOperator), has(StageId::kSupport)); !forces) return forces;
  state_.solve.is_at_finite_strain = forces_.is_at_finite_strain();
  if (Status stages = pipeline_.load(calibration, written()); !stages) return stages;
  if (c.has_kind("rest")) {
    const auto rest = picture("rest.image");
    if (!rest) return rest.error();
    set_rest(rest.value()->as<uint16_t>());
  }
  return Unit{};
}

Result<std::unique_ptr<FramePath>> FramePath::configure(const BoardSettings& board,
                                                        std::shared_ptr<const CalibrationFile> calibration,
                                                        ClockFunction clock) {
  std::unique_ptr<FramePath> path(new FramePath(board, std::move(calibration), clock));
  Status loaded = path->load_tables();
  if (!loaded) return loaded.error();
  return path;
}

Result<std::shared_ptr<const CalibrationFile>> CalibrationFile::load(std::span<const uint8_t> bytes) {
  auto file = std::make_shared<CalibrationFile>();
  file->storage_.resize((bytes.size() + 7) / 8);
  file->n_bytes_ = bytes.size();
  if (!bytes.empty()) std::memcpy(file->storage_.data(), bytes.data(), bytes.size());
  auto parsed = Calibration::parse(file->bytes());
  if (!parsed) return parsed.error();
  file->calibration_ = std::move(parsed).value();
  return std::shared_ptr<const CalibrationFile>(std::move(file));
}

std::span<const uint8_t> CalibrationFile::bytes() const {
  return {reinterpret_cast<const uint8_t*>(storage_.data()), n_bytes_};
}

}  // namespace ruffini
