#include "tiny_sensor.h"

#include <algorithm>
#include <utility>

#include "dice.h"
#include "failure.h"
#include "frame_path.h"
#include "store/signature.h"
#include "support/calibration_bytes.h"
#include "support/dot_picture.h"
#include "support/signed_calibration.h"

namespace ruffini::sim {
namespace {

constexpr int kWidth = 40;
constexpr int kHeight = 28;
constexpr int kFeatures = 12;  // two of each dot
constexpr int kAxes = 6;
constexpr int kPairs = 21;
constexpr int32_t kFullScaleUn = 20'000'000;

BoardSettings tiny_board() {
  BoardSettings board;
  board.name = "tiny";
  board.product = "simulation";
  board.camera = {.optics = "test",
                  .width_px = kWidth,
                  .height_px = kHeight,
                  .rate_mhz = 60'000,
                  .focal_mpx = 200'000,
                  .center_x_mpx = 19'500,
                  .center_y_mpx = 13'500,
                  .standoff_um = 20'000};
  board.pad = {
      .size_x_um = 4'000, .size_y_um = 2'800, .thickness_um = 2'000, .modulus_pa = 200'000, .poisson_1e4 = 4'800};
  board.grid = {5, 4};
  board.n_layers = 2;
  board.window = {.min_x_um = 0, .min_y_um = 0, .max_x_um = 4'000, .max_y_um = 2'800};
  board.markers = {.lattice = {3, 2},
                   .pitch_x_um = 1'200,
                   .pitch_y_um = 1'200,
                   .first_x_um = 800,
                   .first_y_um = 800,
                   .diameter_um = 600,
                   .threshold_1e3 = 120,
                   .max_lost = 1};
  board.depth = {.gauge = Gauge::kMargin, .margin_um = 400, .step_px = 1};
  board.contact = {.threshold_un = 3'000, .min_nodes = 4};
  board.force_lsb_un = 10;
  board.n_rest_frames = 4;
  board.stages = {"difference", "markers", "feature_wrench"};
  return board;
}

struct Recipe {
  std::string board = "tiny";
  std::string serial = "*";
  std::string resolution = "40x28";
  std::string created = "2026-11-22T00:00:00Z";
  int version = 1;
  int32_t gain = 0;
  bool contradicts_touches = false;  // its frames are flagged while something touches
};

// Force along x goes with the sum of the dots' shifts along x; y likewise. The rest is not measured.
Bytes bytes_of(const Recipe& recipe) {
  std::vector<int32_t> gain(size_t{kAxes} * kFeatures);
  for (size_t i = 0; i < kFeatures; ++i) gain[(i % 2) * kFeatures + i] = recipe.gain;
  std::vector<int32_t> error(size_t{2} * kAxes * kAxes);
  error[0] = error[7] = 10'000;  // 10 mN
  test::CalibrationBytes file;
  file.meta("kinds", "wrench")
      .meta("board", recipe.board)
      .meta("optics", "test")
      .meta("resolution", recipe.resolution)
      .meta("sensor_serial", recipe.serial)
      .meta("gel_serial", "*")
      .meta("version", std::to_string(recipe.version))
      .meta("security_epoch", "0")
      .meta("created_utc", recipe.created)
      .meta("wrench.features", "markers")
      .tensor("wrench.gain", "I32", {kAxes, kFeatures}, gain)
      .tensor("wrench.full_scale", "I32", {kAxes}, std::vector<int32_t>{kFullScaleUn, kFullScaleUn, 0, 0, 0, 0})
      .tensor("wrench.square", "I32", {kAxes, kPairs}, std::vector<int32_t>(size_t{kAxes} * kPairs))
      .tensor("wrench.error", "I32", {2, kAxes, kAxes}, error);
  if (recipe.contradicts_touches) {
    file.tensor("wrench.forward", "I32", {kFeatures, kAxes + kPairs},
                std::vector<int32_t>(size_t{kFeatures} * (kAxes + kPairs)))
        .tensor("wrench.tolerance", "I32", {kFeatures}, std::vector<int32_t>(kFeatures, 1 << 14));  // a quarter pixel
  }
  return test::sign(file.tensor("wrench.shift", "U8", {kAxes}, std::vector<uint8_t>(kAxes, 8)).bytes());
}

}  // namespace

TinySensor::TinySensor() : board(tiny_board()) {
  draw();
  make_tables();
}

void TinySensor::draw() {
  const test::DotPicture drawn{.width = kWidth, .height = kHeight, .gradient = 0, .noise = 0};
  for (uint64_t touch = 0; touch < kTouches; ++touch) {
    auto dots = test::nominal_dots(board);
    for (test::Place& dot : dots) dot.x += static_cast<double>(touch) / 2;
    pictures[touch] = drawn.bgr(dots, 1);
  }
  const size_t n_bytes = pictures[0].size();
  pictures[kDarkPicture] = Bytes(n_bytes, 2);
  pictures[kGlarePicture] = Bytes(n_bytes, 255);
  pictures[kNoisePicture] = Bytes(n_bytes);
  Dice dice(1);
  for (uint8_t& value : pictures[kNoisePicture]) value = static_cast<uint8_t>(dice.next());
}

void TinySensor::make_tables() {
  constexpr int32_t kGain = 40'000;
  constexpr int32_t kGainStep = 12'000;
  for (int32_t i = 0; i < 5; ++i) {
    const std::string name = "good " + std::to_string(i);
    add(name, bytes_of({.serial = i % 2 == 0 ? "*" : kSerial, .created = name, .gain = kGain + i * kGainStep}), true);
  }
  add("contradicts touches", bytes_of({.created = "fragile", .gain = kGain, .contradicts_touches = true}), true);
  n_good = tables.size();
  add("another board", bytes_of({.board = "other", .gain = kGain}), false);
  add("another sensor", bytes_of({.serial = "0043", .gain = kGain}), false);
  add("another resolution", bytes_of({.resolution = "28x40", .gain = kGain}), false);
  add("beyond the bounds", bytes_of({.gain = 1 << 27}), false);
  add("versions ahead", bytes_of({.version = 5'000, .gain = kGain}), false);
  Bytes flipped = bytes_of({.gain = kGain});
  flipped[flipped.size() - 100] ^= 1;
  add("flipped after signing", flipped, false);
  Bytes unsigned_file = bytes_of({.gain = kGain});
  std::fill(unsigned_file.end() - 64, unsigned_file.end(), uint8_t{0});
  add("unsigned", unsigned_file, false);
  add("cut short", Bytes(flipped.begin(), flipped.begin() + 700), false);
  add("no table", Bytes(500, 'x'), false);
}

void TinySensor::add(const std::string& name, Bytes bytes, bool is_good) {
  Table table;
  table.name = name;
  table.bytes = std::move(bytes);
  table.is_good = is_good;
  table.sha256 = ruffini::sha256(table.bytes);
  for (size_t i = 0; i < 4; ++i) table.id = table.id << 8 | static_cast<uint8_t>(table.sha256[i]);
  if (is_good) measure(table);
  by_sha256[table.sha256] = by_id[table.id] = tables.size();
  tables.push_back(std::move(table));
}

// What frames say of each touch, by a frame path of its own: whether the daemon says it of the right frame, with the
// right table, is what the simulation asks.
void TinySensor::measure(Table& table) const {
  const auto file = CalibrationFile::load(table.bytes);
  want(file.has_value(), table.name + ": " + (file ? "" : file.error().message));
  auto path = FramePath::configure(board, file.value(), [] { return uint64_t{0}; });
  want(path.has_value(), table.name + ": " + (path ? "" : path.error().message));
  const auto show = [&](uint64_t picture) -> const FrameState& {
    return path.value()->process({pictures[picture].data(), kWidth, kHeight, 3, ptrdiff_t{3} * kWidth});
  };
  for (int i = 0; i < board.n_rest_frames; ++i) show(0);
  for (uint64_t touch = 0; touch < kTouches; ++touch) {
    const FrameState& state = show(touch);
    table.force_un[touch] = state.wrench.sum.force_x_un;
    table.is_valid[touch] = state.wrench.validity[0] == Validity::kValid;
  }
  want(table.is_valid[0] && table.force_un[0] == 0, table.name + ": untouched, it must say a valid nothing");
  want(table.force_un[4] > 4 * kForceLimitUn, table.name + ": its touches cannot be told apart");
  for (uint64_t wrong = kDarkPicture; wrong < kPictures; ++wrong) {
    want(show(wrong).wrench.validity[0] == Validity::kInvalid, table.name + ": a wrong picture must be seen");
  }
}

const Table* TinySensor::good_by_id(uint32_t id) const {
  const auto found = by_id.find(id);
  return found == by_id.end() || !tables[found->second].is_good ? nullptr : &tables[found->second];
}

const Table* TinySensor::good_by_sha256(const std::string& sha256) const {
  const auto found = by_sha256.find(sha256);
  return found == by_sha256.end() || !tables[found->second].is_good ? nullptr : &tables[found->second];
}

}  // namespace ruffini::sim
