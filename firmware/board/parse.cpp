#include "board/parse.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "board/plain_toml.h"
#include "board/reader.h"

namespace ruffini {
namespace {

constexpr size_t kMaxLineLength = 31;  // of a GPIO line, as the kernel has it
constexpr size_t kMaxPathLength = 128;
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

void read_exposure(BoardReader& in, BoardSettings& board) {
  if (!in.has_section("exposure")) return;
  in.section("exposure");
  board.exposure.time_us = in.integer("time_us", 10, 1'000'000);
  board.exposure.gain_1e3 = in.integer("gain_1e3", 1'000, 64'000);
  board.exposure.red_1e3 = in.integer("red_1e3", 100, 32'000);
  board.exposure.blue_1e3 = in.integer("blue_1e3", 100, 32'000);
  if (board.exposure.time_us * board.camera.rate_mhz > 1'000'000'000) {
    in.fail("exposure.time_us is longer than a frame at camera.rate_mhz");
  }
}

void read_light(BoardReader& in, LightSettings& light) {
  if (!in.has_section("light")) return;
  in.section("light");
  light.chip = in.text("chip", kMaxPathLength);
  light.line = in.text("line", kMaxLineLength);
}

// Addresses below 8 and above 0x77 are the bus's own.
void read_eeprom(BoardReader& in, EepromSettings& eeprom) {
  if (!in.has_section("eeprom")) return;
  in.section("eeprom");
  eeprom.bus = in.text("bus", kMaxPathLength);
  if (eeprom.bus.rfind('/', 0) != 0) in.fail("eeprom.bus must begin with /");
  if (in.has("board_address")) eeprom.board_address = in.integer("board_address", 8, 0x77);
  if (in.has("gel_address")) eeprom.gel_address = in.integer("gel_address", 8, 0x77);
  eeprom.address_bytes = static_cast<int>(in.integer("address_bytes", 1, 2));
  if (eeprom.board_address == eeprom.gel_address) {
    in.fail("[eeprom] needs board_address or gel_address, and not the same for both");
  }
}

void read_pad(BoardReader& in, BoardSettings& board) {
  in.section("pad");
  board.pad.size_x_um = in.integer("size_x_um", 1'000, kMaxLengthUm);
  board.pad.size_y_um = in.integer("size_y_um", 1'000, kMaxLengthUm);
  board.pad.thickness_um = in.integer("thickness_um", 100, kMaxLengthUm);
  board.pad.modulus_pa = in.integer("modulus_pa", 1'000, 1'000'000'000);
  board.pad.poisson_1e4 = in.integer("poisson_1e4", 0, 4'999);
  in.section("grid");
  board.grid.n_x = static_cast<int>(in.integer("n_x", 2, 255));
  board.grid.n_y = static_cast<int>(in.integer("n_y", 2, 255));
  board.n_layers = static_cast<int>(in.integer("n_layers", 2, 32));
  in.section("window");
  board.window.min_x_um = in.integer("min_x_um", 0, kMaxLengthUm);
  board.window.min_y_um = in.integer("min_y_um", 0, kMaxLengthUm);
  board.window.max_x_um = in.integer("max_x_um", 0, kMaxLengthUm);
  board.window.max_y_um = in.integer("max_y_um", 0, kMaxLengthUm);
}

// A pipeline without the stage needs no [markers]; the lattice is then empty.
void read_markers(BoardReader& in, MarkerSettings& markers) {
  if (!in.has_section("markers")) return;
  in.section("markers");
  const int polarity = in.choice("polarity", {"dark", "light", "texture"});
  markers.polarity = polarity == 0 ? Polarity::kDark : polarity == 1 ? Polarity::kLight : Polarity::kTexture;
  const int layout = in.has("layout") ? in.choice("layout", {"lattice", "scattered", "views"}) : 0;
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
  // Light markers may stand out by more than all that is round them.
  markers.threshold_1e3 = in.integer("threshold_1e3", 10, markers.polarity == Polarity::kLight ? 1900 : 900);
  markers.max_lost = in.integer("max_lost", 0, 4'096);
}

// As with [markers].
void read_targets(BoardReader& in, TargetSettings& targets) {
  if (!in.has_section("targets")) return;
  in.section("targets");
  targets.places = in.places("places_um", 0, kMaxLengthUm);
  targets.below_um = in.integer("below_um", 0, kMaxLengthUm);
  targets.diameter_um = in.integer("diameter_um", 20, 50'000);
  targets.threshold_1e3 = in.integer("threshold_1e3", 10, 900);
}

// Only of boards whose pipeline has the stage.
void read_skin(BoardReader& in, SkinSettings& skin) {
  if (!in.has_section("skin")) return;
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

void read_reflex(BoardReader& in, ReflexSettings& reflex) {
  if (!in.has_section("reflex")) return;
  in.section("reflex");
  reflex.chip = in.text("chip", kMaxPathLength);
  reflex.line = in.text("line", kMaxLineLength);
  reflex.force_un = in.integer("force_un", 0, 2'000'000'000);
  constexpr ReflexSlip kSlips[] = {ReflexSlip::kNone, ReflexSlip::kIncipient, ReflexSlip::kSlides};
  reflex.slip = kSlips[in.choice("slip", {"none", "incipient", "slides"})];
  constexpr WhenInvalid kWhen[] = {WhenInvalid::kHold, WhenInvalid::kOn, WhenInvalid::kOff};
  reflex.when_invalid = kWhen[in.choice("when_invalid", {"hold", "on", "off"})];
  if (reflex.force_un == 0 && reflex.slip == ReflexSlip::kNone) {
    in.fail("[reflex] has no limit: give force_un above 0, or slip");
  }
}

void read_rest(BoardReader& in, BoardSettings& board) {
  in.section("depth");
  if (in.has("source") && in.choice("source", {"light", "markers"}) == 1) board.depth.source = DepthSource::kMarkers;
  constexpr Gauge kGauges[] = {Gauge::kMargin, Gauge::kMean, Gauge::kSpacing, Gauge::kVolume, Gauge::kBoth};
  board.depth.gauge = kGauges[in.choice("gauge", {"margin", "mean", "spacing", "volume", "both"})];
  board.depth.margin_um = in.integer("margin_um", 0, kMaxLengthUm);
  board.depth.step_px = static_cast<int>(in.integer("step_px", 1, 4));
  in.section("contact");
  board.contact.threshold_un = in.integer("threshold_un", 1, 100'000'000);
  board.contact.min_nodes = in.integer("min_nodes", 1, 10'000);
  in.section("field");
  board.force_lsb_un = in.integer("force_lsb_un", 1, 1'000);
  if (in.has_section("memory")) {
    in.section("memory");
    board.calibration_kb = in.integer("calibration_kb", 64, kMaxCalibrationKb);
  }
  if (in.has_section("temperature")) {
    in.section("temperature");
    board.temperature.place = in.text("place", kMaxListedLength);
    board.temperature.path = in.text("path", kMaxPathLength);
    if (board.temperature.path.rfind('/', 0) != 0) in.fail("temperature.path must begin with /");
  }
  if (in.has_section("learned")) {
    in.section("learned");
    board.learned.network = in.text("network");
    if (board.learned.network.find('/') != std::string::npos) in.fail("learned.network must be a name without /");
  }
  in.section("pipeline");
  board.n_rest_frames = static_cast<int>(in.integer("n_rest_frames", 1, 256));
  board.stages = in.texts("stages", known_stages().size());
}

bool stages_in_order(const std::vector<std::string>& stages) {
  auto place = known_stages().begin();
  for (const std::string& stage : stages) {
    place = std::find(place, known_stages().end(), stage);
    if (place == known_stages().end()) return false;
    ++place;
  }
  return !stages.empty();
}

void check_views(BoardReader& in, const BoardSettings& board) {
  const MarkerSettings& markers = board.markers;
  if (!markers.places.empty()) return in.fail("markers.places_um needs markers.layout = \"scattered\"");
  if (board.camera.width_px % markers.lattice.n_y != 0) {
    return in.fail("camera.width_px is no multiple of the markers.n_y views that it holds");
  }
  const auto makes_a_field = [](const std::string& stage) { return stage == "displacement" || stage == "photometric"; };
  if (std::any_of(board.stages.begin(), board.stages.end(), makes_a_field)) {
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
  if (markers.lattice.count() == 0) {
    const auto needs_them = [](const std::string& stage) { return stage == "markers" || stage == "displacement"; };
    if (std::any_of(board.stages.begin(), board.stages.end(), needs_them)) in.fail("section [markers] is missing");
    return;
  }
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
  if (std::find(board.stages.begin(), board.stages.end(), "photometric") != board.stages.end()) {
    in.fail("markers.polarity texture leaves no shading to the stage photometric: leave one of them out");
  }
  if (std::min(board.camera.width_px, board.camera.height_px) < 64) {  // TextureFlow::kMinSizePx
    in.fail("markers.polarity texture needs an image of at least 64 x 64 pixels");
  }
}

bool has_stage(const BoardSettings& board, const char* name) {
  return std::find(board.stages.begin(), board.stages.end(), name) != board.stages.end();
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
  if (has_stage(board, "feature_wrench")) {
    if (!has_stage(board, "targets") && !has_stage(board, "markers")) {
      in.fail("stage feature_wrench needs the stage targets or markers");
    } else if (has_stage(board, "wrench")) {
      in.fail("stages wrench and feature_wrench both say the wrench: leave one of them out");
    }
  }
  if (has_stage(board, "contact_model")) {
    if (!has_stage(board, "feature_wrench") || board.markers.polarity != Polarity::kTexture) {
      in.fail("stage contact_model needs the stage feature_wrench and markers.polarity texture");
    } else if (has_stage(board, "contacts")) {
      in.fail("stages contacts and contact_model both say the contacts: leave one of them out");
    }
  }
  if (has_stage(board, "contact_depth") && !has_stage(board, "contact_model")) {
    in.fail("stage contact_depth needs the stage contact_model");
  }
  if (has_stage(board, "helmholtz")) {
    const MarkerSettings& m = board.markers;
    const int64_t most = 4;  // Helmholtz::kMostOblong
    if (!has_stage(board, "contact_model")) {
      in.fail("stage helmholtz needs the stage contact_model");
    } else if (m.pitch_x_um > most * m.pitch_y_um || m.pitch_y_um > most * m.pitch_x_um) {
      in.fail("stage helmholtz needs markers.pitch_x_um and pitch_y_um within four times each other");
    }
  }
  if (targets.places.empty()) {
    if (has_stage(board, "targets")) in.fail("section [targets] is missing");
    return;
  }
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

void check_skin(BoardReader& in, const BoardSettings& board) {
  const SkinSettings& skin = board.skin;
  const int64_t weights = skin.weights[0] + skin.weights[1] + skin.weights[2];
  const bool has_stage = std::find(board.stages.begin(), board.stages.end(), "skin") != board.stages.end();
  if (weights == 0 && skin.level == 0) {
    if (has_stage) in.fail("section [skin] is missing");
    return;
  }
  if (weights < 1 || weights > 8) in.fail("[skin] weights must sum to 1 to 8");
  if ((skin.shape == SkinShape::kPlane) != (skin.radius_um == 0)) {
    in.fail("skin.radius_um must be 0 for a plane and above 0 for a tube or a dome");
  }
}

// What no single key can tell.
void cross_check(BoardReader& in, const BoardSettings& board) {
  const WindowSettings& window = board.window;
  if (window.max_x_um > board.pad.size_x_um || window.max_y_um > board.pad.size_y_um) {
    in.fail("[window] reaches beyond the pad");
  } else if (window.min_x_um >= window.max_x_um || window.min_y_um >= window.max_y_um) {
    in.fail("[window] is empty: min must be below max");
  } else if (observed_nodes(board.grid.n_x, board.pad.size_x_um, window.min_x_um, window.max_x_um).count < 2 ||
             observed_nodes(board.grid.n_y, board.pad.size_y_um, window.min_y_um, window.max_y_um).count < 2) {
    in.fail("[window] holds fewer than 2 node lines: widen it or refine [grid]");
  }
  check_markers(in, board);
  check_gauge(in, board);
  check_depth(in, board);
  check_skin(in, board);
  const MarkerSettings& markers = board.markers;
  const bool has_two_eyes = markers.has_views && markers.lattice.n_y == 2 && has_stage(board, "markers");
  if (has_stage(board, "fingertip") && !has_two_eyes) {
    in.fail("stage fingertip needs the stage markers and markers.layout views with n_y 2");
  }
  check_targets(in, board);
  if (board.depth.step_px == 3 || board.camera.width_px % board.depth.step_px != 0 ||
      board.camera.height_px % board.depth.step_px != 0) {
    in.fail("depth.step_px must be 1, 2 or 4 and divide the image");
  }
  const int64_t widest_px = std::max(board.camera.width_px, board.camera.height_px);
  if (board.depth.step_px > 0 && widest_px / board.depth.step_px > 640) {  // Poisson::kMaxCells
    in.fail("the depth grid has more than 640 cells: use a larger depth.step_px");
  }
  if (widest_px * 1000 * board.camera.standoff_um > 2'000'000 * board.camera.focal_mpx) {
    in.fail("[camera] sees more than 2 m of pad: check focal_mpx and standoff_um");
  }
  if (board.camera.center_x_mpx >= int64_t{1000} * board.camera.width_px ||
      board.camera.center_y_mpx >= int64_t{1000} * board.camera.height_px) {
    in.fail("[camera] center is outside the image");
  }
  if (!stages_in_order(board.stages)) {
    std::string list;
    for (const std::string& name : known_stages()) list += (list.empty() ? "" : ", ") + name;
    in.fail("pipeline.stages must be some of " + list + ", in this order");
  }
}

}  // namespace

Result<BoardSettings> parse_board(std::string_view text, const std::string& where) {
  if (text.size() > kMaxBoardBytes) {
    return Error{ErrorKind::kBadInput, where + ": has more than " + std::to_string(kMaxBoardBytes) +
                                           " bytes: move comments into the board's README.md"};
  }
  const Result<toml::table> parsed = parse_plain_toml(text, where);
  if (!parsed) return parsed.error();
  const toml::table& root = parsed.value();
  BoardReader in(root, where);
  if (root["schema"].value_exact<int64_t>() != int64_t{1}) in.fail("schema must be 1");
  BoardSettings board;
  in.section("board");
  board.name = in.text("name");
  board.product = in.text("product", 128);
  board.not_measured = in.texts("not_measured", kMaxNotMeasured);
  read_camera(in, board.camera);
  read_exposure(in, board);
  read_light(in, board.light);
  read_eeprom(in, board.eeprom);
  read_pad(in, board);
  read_markers(in, board.markers);
  read_skin(in, board.skin);
  read_targets(in, board.targets);
  read_rest(in, board);
  read_reflex(in, board.reflex);
  in.refuse_unknown();
  if (in.error().empty()) cross_check(in, board);
  if (!in.error().empty()) return Error{ErrorKind::kBadInput, in.error()};
  board.toml = std::string(text);
  return board;
}

Result<BoardSettings> load_board(const std::string& folder) {
  const std::filesystem::path path = std::filesystem::path(folder) / "board.toml";
  std::ifstream stream(path, std::ios::binary);
  if (!stream) {
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
