#include "board/parse.h"

#include <filesystem>
#include <fstream>
#include <sstream>

#include "board/cross_check.h"
#include "board/plain_toml.h"
#include "board/read_hardware.h"
#include "board/reader.h"
#include "core/stages.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxLengthUm = 500'000;  // half a metre: no tactile pad is larger

void read_camera(BoardReader& in, CameraSettings& camera) {
  in.section("camera");
  camera.optics = in.text("optics");
  camera.width_px = static_cast<int>(in.integer("width_px", 16, 4096));
  camera.height_px = static_cast<int>(in.integer("height_px", 16, 4096));
  camera.rate_mhz = in.integer("rate_mhz", 100, 1'000'000);
  camera.focal_mpx = in.integer("focal_mpx", 10'000, 20'000'000);
  camera.center_x_mpx = in.integer("center_x_mpx", 0, 4'096'000);
  camera.center_y_mpx = in.integer("center_y_mpx", 0, 4'096'000);
  camera.standoff_um = in.integer("standoff_um", 1'000, kMaxLengthUm);
}

void read_pad(BoardReader& in, BoardSettings& board) {
  in.section("pad");
  board.pad.size_x_um = in.integer("size_x_um", 1'000, kMaxLengthUm);
  board.pad.size_y_um = in.integer("size_y_um", 1'000, kMaxLengthUm);
  board.pad.thickness_um = in.integer("thickness_um", 100, kMaxLengthUm);
  board.pad.modulus_pa = in.integer("modulus_pa", 1'000, 1'000'000'000);
  board.pad.poisson_1e4 = in.integer("poisson_1e4", 0, 4'999);
  in.set_default("stiffness_sigma_1e3", board.pad.stiffness_sigma_1e3);
  board.pad.stiffness_sigma_1e3 = in.integer("stiffness_sigma_1e3", 0, 500);
}

// An optional section that none of the board's stages reads.
void section_of_stages(BoardReader& in, const BoardSettings& board, const char* name, toml::table set_default) {
  is_section_read(board.stages, name) ? in.section(name) : in.section_or(name, std::move(set_default));
}

// Default: four nodes at the pad's corners.
void read_grid(BoardReader& in, BoardSettings& board) {
  section_of_stages(in, board, "grid", toml::table{{"n_x", 2}, {"n_y", 2}, {"n_layers", 2}});
  board.grid.n_x = static_cast<int>(in.integer("n_x", 2, 255));
  board.grid.n_y = static_cast<int>(in.integer("n_y", 2, 255));
  board.n_layers = static_cast<int>(in.integer("n_layers", 2, 32));
  section_of_stages(
      in, board, "window",
      toml::table{
          {"min_x_um", 0}, {"min_y_um", 0}, {"max_x_um", board.pad.size_x_um}, {"max_y_um", board.pad.size_y_um}});
  board.window.min_x_um = in.integer("min_x_um", 0, kMaxLengthUm);
  board.window.min_y_um = in.integer("min_y_um", 0, kMaxLengthUm);
  board.window.max_x_um = in.integer("max_x_um", 0, kMaxLengthUm);
  board.window.max_y_um = in.integer("max_y_um", 0, kMaxLengthUm);
}

// Required by certain stages, without a default: boards without these stages may still have the section.
bool has_own_section(BoardReader& in, const BoardSettings& board, const char* name) {
  return in.has_section(name) || is_section_read(board.stages, name);
}

void read_markers(BoardReader& in, const BoardSettings& board, MarkerSettings& markers) {
  if (!has_own_section(in, board, "markers")) return;
  in.section("markers");
  const int polarity = in.choice("polarity", {"dark", "light", "texture"});
  markers.polarity = polarity == 0 ? Polarity::kDark : polarity == 1 ? Polarity::kLight : Polarity::kTexture;
  in.set_default("layout", "lattice");
  const int layout = in.choice("layout", {"lattice", "scattered", "views"});
  markers.is_scattered = layout > 0;
  markers.has_views = layout == 2;
  if (in.has("places_um")) markers.places = in.places("places_um", 0, kMaxLengthUm);
  markers.lattice.n_x = static_cast<int>(in.integer("n_x", 2, markers.has_views ? 1024 : 64));
  markers.lattice.n_y = static_cast<int>(in.integer("n_y", 2, markers.has_views ? 4 : 64));
  markers.pitch_x_um = in.integer("pitch_x_um", 100, 100'000);
  markers.pitch_y_um = in.integer("pitch_y_um", 100, 100'000);
  markers.first_x_um = in.integer("first_x_um", 0, kMaxLengthUm);
  markers.first_y_um = in.integer("first_y_um", 0, kMaxLengthUm);
  markers.diameter_um = in.integer("diameter_um", 20, 50'000);
  // Light markers may exceed their surroundings by more than 100 %.
  markers.threshold_1e3 = in.integer("threshold_1e3", 10, markers.polarity == Polarity::kLight ? 1900 : 900);
  markers.max_lost = in.integer("max_lost", 0, 4'096);
}

void read_targets(BoardReader& in, const BoardSettings& board, TargetSettings& targets) {
  if (!has_own_section(in, board, "targets")) return;
  in.section("targets");
  targets.places = in.places("places_um", 0, kMaxLengthUm);
  targets.below_um = in.integer("below_um", 0, kMaxLengthUm);
  targets.diameter_um = in.integer("diameter_um", 20, 50'000);
  targets.threshold_1e3 = in.integer("threshold_1e3", 10, 900);
}

void read_picture_features(BoardReader& in, const BoardSettings& board, PictureFeatureSettings& features) {
  if (!has_own_section(in, board, "picture_features")) return;
  in.section("picture_features");
  for (const PadPlace& corner : in.places("corners_px", 0, 4'095))
    features.corners.push_back({corner.x_um, corner.y_um});
  features.cells.n_x = static_cast<int>(in.integer("n_x", 1, 32));
  features.cells.n_y = static_cast<int>(in.integer("n_y", 1, 32));
}

void read_skin(BoardReader& in, const BoardSettings& board, SkinSettings& skin) {
  if (!has_own_section(in, board, "skin")) return;
  in.section("skin");
  const int shape = in.choice("shape", {"plane", "tube", "dome"});
  skin.shape = shape == 0 ? SkinShape::kPlane : shape == 1 ? SkinShape::kTube : SkinShape::kDome;
  skin.radius_um = in.integer("radius_um", 0, kMaxLengthUm);
  skin.n_panels = in.integer("n_panels", 1, 64);
  const int mode = in.choice("mode", {"single", "multi", "auto"});
  skin.mode = mode == 0 ? SkinMode::kSingle : mode == 1 ? SkinMode::kMulti : SkinMode::kAuto;
  skin.weights = {in.integer("weight_b", 0, 8), in.integer("weight_g", 0, 8), in.integer("weight_r", 0, 8)};
  skin.level = in.integer("level", 1, 2'000);
  skin.min_area_px = in.integer("min_area_px", 1, 1'000'000);
  skin.averaged_frames = static_cast<int>(in.integer("averaged_frames", 1, kMaxAveragedFrames));
}

void read_rest(BoardReader& in, BoardSettings& board) {
  section_of_stages(in, board, "depth", toml::table{{"gauge", "margin"}, {"margin_um", 0}, {"step_px", 1}});
  in.set_default("source", "light");
  if (in.choice("source", {"light", "markers"}) == 1) board.depth.source = DepthSource::kMarkers;
  constexpr Gauge kGauges[] = {Gauge::kMargin, Gauge::kMean, Gauge::kSpacing, Gauge::kVolume, Gauge::kBoth};
  board.depth.gauge = kGauges[in.choice("gauge", {"margin", "mean", "spacing", "volume", "both"})];
  board.depth.margin_um = in.integer("margin_um", 0, kMaxLengthUm);
  board.depth.step_px = static_cast<int>(in.integer("step_px", 1, 4));
  section_of_stages(in, board, "contact", toml::table{{"threshold_un", 1}, {"min_nodes", 1}});
  board.contact.threshold_un = in.integer("threshold_un", 1, 100'000'000);
  board.contact.min_nodes = in.integer("min_nodes", 1, 10'000);
  in.set_default("steady_frames", 1);
  board.contact.steady_frames = static_cast<int>(in.integer("steady_frames", 1, kMaxSteadyFrames));
  section_of_stages(in, board, "field", toml::table{{"force_lsb_un", 10}});
  board.force_lsb_un = in.integer("force_lsb_un", 1, 1'000);
  in.section_or("memory", toml::table{{"calibration_kb", board.calibration_kb}});
  board.calibration_kb = in.integer("calibration_kb", 64, kMaxCalibrationKb);
  if (in.has_section("learned")) {
    in.section("learned");
    board.learned.network = in.text("network");
    if (board.learned.network.find('/') != std::string::npos) in.fail("learned.network must be a name without /");
  }
}

void read_pipeline(BoardReader& in, BoardSettings& board) {
  in.section("pipeline");
  board.n_rest_frames = static_cast<int>(in.integer("n_rest_frames", 1, 256));
  board.stages = in.texts("stages", stage_names().size());
  in.set_default("cores", int64_t{1});
  board.n_cores = static_cast<int>(in.integer("cores", 1, 2));
}

struct ReadBoard {
  BoardSettings settings;
  toml::table table;
};

Result<ReadBoard> read_board(std::string_view text, const std::string& where) {
  if (text.size() > kMaxBoardBytes) {
    return Error{ErrorKind::kBadInput, where + ": has more than " + std::to_string(kMaxBoardBytes) +
                                           " bytes: move comments into the board's README.md"};
  }
  Result<toml::table> parsed = parse_plain_toml(text, where);
  if (!parsed) return parsed.error();
  BoardReader in(std::move(parsed).value(), where);
  if (in.root()["schema"].value_exact<int64_t>() != int64_t{1}) in.fail("schema must be 1");
  BoardSettings board;
  in.section("board");
  board.name = in.text("name");
  board.product = in.text("product", 128);
  board.not_measured = in.texts("not_measured", kMaxNotMeasured);
  read_pipeline(in, board);  // determines which of the sections below are required
  read_camera(in, board.camera);
  read_hardware(in, board);
  read_pad(in, board);
  read_grid(in, board);
  read_markers(in, board, board.markers);
  read_skin(in, board, board.skin);
  read_targets(in, board, board.targets);
  read_picture_features(in, board, board.picture_features);
  read_rest(in, board);
  in.refuse_unknown();
  if (in.error().empty()) cross_check(in, board);
  if (!in.error().empty()) return Error{ErrorKind::kBadInput, in.error()};
  board.toml = std::string(text);
  return ReadBoard{std::move(board), in.root()};
}

}  // namespace

Result<BoardSettings> parse_board(std::string_view text, const std::string& where) {
  Result<ReadBoard> read = read_board(text, where);
  if (!read) return read.error();
  return std::move(read).value().settings;
}

Result<std::string> board_json(std::string_view text, const std::string& where) {
  const Result<ReadBoard> read = read_board(text, where);
  if (!read) return read.error();
  std::ostringstream json;
  json << toml::json_formatter(read.value().table, toml::format_flags::none);
  return json.str();
}

Result<BoardSettings> load_board(const std::string& folder) {
  const std::filesystem::path path = std::filesystem::path(folder) / "board.toml";
  std::error_code failed;  // opening a pipe would block
  std::ifstream stream;
  if (std::filesystem::is_regular_file(path, failed)) stream.open(path, std::ios::binary);
  if (!stream.is_open()) {
    return Error{ErrorKind::kUnavailable, path.string() + ": cannot be read: is this a board folder?"};
  }
  std::ostringstream text;
  text << stream.rdbuf();
  Result<BoardSettings> board = parse_board(text.str(), path.string());
  if (!board) return board;
  const std::string name = std::filesystem::weakly_canonical(path).parent_path().filename().string();
  if (board.value().name != name) {
    return Error{ErrorKind::kBadInput, path.string() + ": board.name is \"" + board.value().name +
                                           "\" but the folder is called \"" + name + "\""};
  }
  return board;
}

}  // namespace ruffini
