// What a path is made of before its first frame: the calibration's tables, checked against the board.
#include <algorithm>
#include <cstring>
#include <utility>

#include "frame_path.h"

namespace ruffini {
namespace {

// All of them, or none: then uncertainty is not measured.
constexpr std::array kErrorTensors = {"support.error_reported", "support.error_quiet", "support.error_local",
                                      "support.error_wrench"};

}  // namespace

// Depth and nodes are then computed in the view of the map's ideal pinhole.
Status FramePath::load_camera_map() {
  auto map = CameraMap::load(calibration_->get(), board_);
  if (!map) return map.error();
  camera_map_.emplace(std::move(map).value());
  poisson_ = Poisson(camera_map_->ideal_board());
  displacement_ = Displacement(camera_map_->ideal_board(), &*camera_map_);
  return Unit{};
}

Status FramePath::load_skin() {
  if (!has(Stage::kSkin)) return Unit{};
  auto skin = Skin::load(board_, calibration_ ? &calibration_->get() : nullptr);
  if (!skin) return skin.error();
  skin_.emplace(std::move(skin).value());
  return Unit{};
}

// Which tables the calibration brings, and whether they fit this board.
Status FramePath::load_tables() {
  const Status skin = load_skin();
  if (!skin) return skin.error();
  if (!calibration_) return Unit{};
  const Calibration& c = calibration_->get();
  if (std::ssize(calibration_->bytes()) > board_.calibration_kb * 1024) {
    return Error{ErrorKind::kBadInput, "calibration file: larger than the " + std::to_string(board_.calibration_kb) +
                                           " kB of [memory] calibration_kb: make one with fewer nodes"};
  }
  if (c.has_kind("dark")) {
    auto dark = c.tensor("dark.image", Tensor::Type::kU16, {board_.camera.height_px, board_.camera.width_px, 3});
    if (!dark) return dark.error();
    rest_.set_dark(dark.value()->as<uint16_t>());
  }
  if (c.has_kind("camera")) {
    const Status camera = load_camera_map();
    if (!camera) return camera.error();
  }
  if (c.has_kind("views")) {
    auto views = ViewMaps::load(c, board_);
    if (!views) return views.error();
    views_ = std::move(views).value();
  }
  if (has(Stage::kPhotometric) && c.has_kind("photometric")) {
    const auto table = PhotometricTable::load(c);
    if (!table) return table.error();
    photometric_.emplace(board_, table.value());
    is_foreign_optics_ = c.text("optics") != board_.camera.optics;
  }
  if (board_.depth.source == DepthSource::kMarkers && c.has_kind("marker_depth")) {
    auto depth = MarkerDepth::load(c, board_);
    if (!depth) return depth.error();
    marker_depth_.emplace(std::move(depth).value());
  }
  if (has(Stage::kOperator) && c.has_kind("operator")) {
    const int n = 3 * nodes_.size().count();
    const std::pair<const char*, int64_t> expected[] = {{"operator.n_x", nodes_.size().n_x},
                                                        {"operator.n_y", nodes_.size().n_y},
                                                        {"operator.force_lsb_un", board_.force_lsb_un},
                                                        {"operator.displacement_lsb_nm", kDisplacementLsbNm}};
    for (const auto& [key, value] : expected) {
      const auto found = c.integer(key, value, value);
      if (!found) return found.error();
    }
    auto op = BlockProgram::load(c, "operator", n, n);
    if (!op) return op.error();
    operator_ = std::move(op).value();
  }
  if (operator_ && c.has_kind("contact")) {
    const Status noise = mask_.load_noise(c, board_.force_lsb_un);
    if (!noise) return noise.error();
  }
  if (has(Stage::kSupport) && operator_ && c.has_kind("support")) {
    auto support = SupportSolver::load(c, nodes_.size(), nodes_.places());
    if (!support) return support.error();
    support_.emplace(std::move(support).value());
    const auto is_there = [&](const char* name) { return c.tensor(name) != nullptr; };
    if (std::any_of(kErrorTensors.begin(), kErrorTensors.end(), is_there)) {
      auto node_error = NodeSigmaModel::load(c, nodes_.size(), contact_threshold_lsb_);
      if (!node_error) return node_error.error();
      auto wrench_error = WrenchErrorModel::load(c, board_.pad);
      if (!wrench_error) return wrench_error.error();
      node_error_ = node_error.value();
      wrench_error_ = wrench_error.value();
    }
  }
  if (support_ && c.has_kind("finite_strain")) {
    auto finite_strain = FiniteStrain::load(c, nodes_.size());
    if (!finite_strain) return finite_strain.error();
    finite_strain_.emplace(std::move(finite_strain).value());
  }
  if (support_ && c.has_kind("relaxation")) {
    auto relaxation = Relaxation::load(c, nodes_.size().count());
    if (!relaxation) return relaxation.error();
    relaxation_.emplace(std::move(relaxation).value());
  }
  if (has(Stage::kFeatureWrench) && c.has_kind("wrench")) {
    auto map = FeatureWrench::load(c, has_targets() ? "targets" : "markers", n_features());
    if (!map) return map.error();
    feature_wrench_.emplace(std::move(map).value());
    features_.resize(static_cast<size_t>(n_features()));
  }
  if (c.has_kind("rest")) {
    auto image = c.tensor("rest.image", Tensor::Type::kU16, {board_.camera.height_px, board_.camera.width_px, 3});
    if (!image) return image.error();
    set_rest(image.value()->as<uint16_t>());
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
