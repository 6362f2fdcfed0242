// board.toml as typed integers. The keys, their units and ranges: boards/README.md.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "base/image_view.h"
#include "board/hardware_settings.h"
#include "board/reflex_settings.h"

namespace ruffini {

// Limits of what HELLO carries.
inline constexpr size_t kMaxBoardBytes = 8'000;  // of the file
inline constexpr size_t kMaxNotMeasured = 8;
inline constexpr int64_t kMaxCalibrationKb = 131'072;  // size limit of one upload
inline constexpr size_t kMaxListedLength = 23;         // length of a stage's or quantity's name

enum class Polarity { kDark, kLight, kTexture };                // dots, or patches of a texture
enum class Gauge { kMargin, kMean, kSpacing, kVolume, kBoth };  // the last three use a table
enum class DepthSource { kLight, kMarkers };
enum class SkinShape { kPlane, kTube, kDome };
enum class SkinMode { kSingle, kMulti, kAuto };  // one touch, several, or as many as are seen

struct CameraSettings {
  std::string optics;
  int width_px = 0;
  int height_px = 0;
  int64_t rate_mhz = 0;
  int64_t focal_mpx = 0;
  int64_t center_x_mpx = 0;
  int64_t center_y_mpx = 0;
  int64_t standoff_um = 0;
};

struct PadSettings {
  int64_t size_x_um = 0;
  int64_t size_y_um = 0;
  int64_t thickness_um = 0;
  int64_t modulus_pa = 0;
  int64_t poisson_1e4 = 0;
  int64_t stiffness_sigma_1e3 = 100;  // relative, of the force that these numbers give for a displacement
};

struct WindowSettings {
  int64_t min_x_um = 0;
  int64_t min_y_um = 0;
  int64_t max_x_um = 0;
  int64_t max_y_um = 0;
};

// Position relative to the pad's corner.
struct PadPlace {
  int64_t x_um = 0;
  int64_t y_um = 0;
};

struct PicturePlace {
  int64_t x_px = 0;
  int64_t y_px = 0;
};

// Grid on a gel that is a quadrilateral in the picture.
struct PictureFeatureSettings {
  std::vector<PicturePlace> corners{};  // top left, top right, bottom right, bottom left
  GridSize cells;
};

struct MarkerSettings {
  Polarity polarity = Polarity::kDark;
  bool is_scattered = false;       // not on the lattice, which then only gives their number
  bool has_views = false;          // the frame is n_y views side by side, with n_x scattered markers in each
  std::vector<PadPlace> places{};  // of scattered markers, if they are listed
  GridSize lattice;
  int64_t pitch_x_um = 0;
  int64_t pitch_y_um = 0;
  int64_t first_x_um = 0;
  int64_t first_y_um = 0;
  int64_t diameter_um = 0;
  int64_t threshold_1e3 = 0;
  int64_t max_lost = 0;
};

// Dark discs on the carrier of the pad, given by their centres.
struct TargetSettings {
  std::vector<PadPlace> places{};
  int64_t below_um = 0;  // behind the undeformed surface
  int64_t diameter_um = 0;
  int64_t threshold_1e3 = 0;
};

struct DepthSettings {
  DepthSource source = DepthSource::kLight;
  Gauge gauge = Gauge::kMargin;
  int64_t margin_um = 0;
  int step_px = 1;

  [[nodiscard]] bool has_gauge_table() const { return gauge != Gauge::kMargin && gauge != Gauge::kMean; }
};

inline constexpr int kMaxSteadyFrames = 32;
struct ContactSettings {
  int64_t threshold_un = 0;
  int64_t min_nodes = 0;
  int steady_frames = 1;  // over which the field of an unchanging contact is averaged
};

// A skin that becomes brighter where it is pressed; radius 0 for a plane. Limits of the weights: image/glow.h.
struct SkinSettings {
  SkinShape shape = SkinShape::kPlane;
  int64_t radius_um = 0;
  int64_t n_panels = 1;  // separate panels, side by side along x
  SkinMode mode = SkinMode::kAuto;
  std::array<int64_t, 3> weights{};  // of B, G, R in the brightness
  int64_t level = 0;                 // of the weighted sum, in grey levels, above which a pixel is touched
  int64_t min_area_px = 0;
  int averaged_frames = 1;
};
inline constexpr int kMaxAveragedFrames = 10;

// A learned network beside the frame path (proto/NETWORK.md): its file in the store's folder; empty: none.
struct LearnedSettings {
  std::string network;
};

struct BoardSettings {
  std::string name;
  std::string product;
  std::vector<std::string> not_measured;
  CameraSettings camera;
  ExposureSettings exposure;
  UsbSettings usb;
  PadSettings pad;
  GridSize grid;  // nodes over the whole pad
  int n_layers = 0;
  WindowSettings window;
  MarkerSettings markers;
  TargetSettings targets;
  PictureFeatureSettings picture_features;
  DepthSettings depth;
  ContactSettings contact;
  SkinSettings skin;
  LightSettings light;
  LedDriverSettings led_driver;
  StereoSettings stereo;
  EepromSettings eeprom;
  TemperatureSettings temperature;
  LearnedSettings learned;
  ReflexSettings reflex;
  ThreadsSettings threads;
  int64_t force_lsb_un = 0;
  int64_t calibration_kb = kMaxCalibrationKb;  // room for the calibration file
  int n_rest_frames = 0;
  int n_cores = 1;  // of the frame path (core/stages.h)
  std::vector<std::string> stages;
  std::string toml;  // source text of these settings
};

// First observed node and number of observed nodes along one axis.
struct NodeRange {
  int first = 0;
  int count = 0;
};

// Returns the nodes of [0, size] in n - 1 steps that lie in [low, high]; lengths in micrometres.
[[nodiscard]] constexpr NodeRange observed_nodes(int n, int64_t size_um, int64_t low_um, int64_t high_um) {
  const int64_t steps = n - 1;
  const int64_t first = (low_um * steps + size_um - 1) / size_um;
  const int64_t last = (high_um * steps) / size_um;
  return {static_cast<int>(first), static_cast<int>(last - first + 1)};
}

}  // namespace ruffini
