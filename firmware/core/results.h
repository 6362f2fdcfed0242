// Results of the estimators: the plain data of the slots (slots.h).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "image/displacement.h"
#include "solve/contact_mask.h"

namespace ruffini {

// The numeric values are those of Validity in ruffini.proto.
enum class Validity : uint8_t { kNotMeasured = 0, kValid = 1, kUncalibrated = 2, kInvalid = 3 };

// Forces of the observed nodes.
struct SolvedForces {
  std::vector<int16_t> u;         // displacement, xyz interleaved
  std::vector<NodeForce> force;   // linear in u, unless the second pass has refined it
  std::span<const uint8_t> mask;  // degree of contact, ContactMask's 0..128
  int64_t threshold_lsb = 0;      // threshold of the mask (solve/contact_mask.h)
  bool is_pressed = false;        // ContactMask::is_pressed()
  // False while the light drifts and nothing was touched before: the drift's effect on depth cannot be distinguished
  // from a faint touch
  bool is_light_steady = true;
  bool is_refined = false;  // by the second pass, in this frame
  bool is_at_finite_strain = false;
  bool is_explained = true;  // by the second pass: the forces explain the whole load (solve/spread_check.h)
  std::span<const int32_t> residual_at_sides;  // of CameraMotion::unknowns(), from the last second pass
};

struct Wrench {
  int64_t force_x_un = 0;
  int64_t force_y_un = 0;
  int64_t force_z_un = 0;
  int64_t torque_x_un_um = 0;
  int64_t torque_y_un_um = 0;
  int64_t torque_z_un_um = 0;
  bool operator==(const Wrench&) const = default;
};

struct WrenchCovariance {
  static constexpr size_t kSize = 21;
  std::array<int64_t, kSize> upper{};
  bool operator==(const WrenchCovariance&) const = default;
};

// Pad temperature now and when rest was learned, thousandths of a degree Celsius; empty: not measured.
struct Warmth {
  std::optional<int32_t> now_mc{};
  std::optional<int32_t> rest_mc{};
};

struct Contact {
  int n_nodes = 0;
  int64_t area_um2 = 0;
  int64_t center_x_um = 0;
  int64_t center_y_um = 0;
  int64_t force_x_un = 0;
  int64_t force_y_un = 0;
  int64_t force_z_un = 0;
  int64_t peak_depth_nm = 0;  // lowest u_z
  int first_node = 0;
  uint16_t component = 0;  // its number in ContactFinder::component()
  bool reaches_border = false;
};

struct ContactList {
  static constexpr int kMax = 8;
  std::array<Contact, kMax> contacts{};
  int n_listed = 0;
  int n_found = 0;
  bool reaches_border = false;  // true if any contact found does
};

// The numeric values are those of SlipState in ruffini.proto.
enum class SlipState : uint8_t { kUnknown = 0, kSticks = 1, kIncipient = 2, kSlides = 3 };
enum class NodeSlip : uint8_t { kFree = 0, kSticks = 1, kSlips = 2 };

struct ContactSlip {
  SlipState state = SlipState::kUnknown;
  int32_t ratio_1e3 = 0;           // |F_t| / F_n
  int32_t friction_1e3 = 0;        // mu; 0: not measured yet
  int32_t friction_sigma_1e3 = 0;  // 20 % from the rim, 3 % from a contact that slid
  int32_t share_1e3 = 0;           // share of the contact's nodes that slip
  int64_t margin_un = 0;           // mu F_n - |F_t|; only if friction is known
};

// A touch of a skin that becomes brighter where it is pressed. Coordinates are on the unrolled skin: x and y along the
// undeformed surface, relative to its centre. Only the force along the local normal is measured. Touches are sorted by
// force.
struct SkinTouch {
  uint32_t id = 0;  // constant from frame to frame (skin_track.h); 0: not assigned yet
  int64_t x_um = 0;
  int64_t y_um = 0;
  int64_t area_um2 = 0;        // area of the taxels that it lights up; 0: unknown
  int64_t brightness_q2 = 0;   // 1/4 levels of the weighted channels; with taxels 1/4096 of rest
  int64_t press_un = 0;        // into the skin
  int64_t press_sigma_un = 0;  // standard deviations; 0: not stated
  int64_t place_sigma_um = 0;  // of x and of y
};

struct SkinTouchList {
  static constexpr int kMax = 8;
  std::array<SkinTouch, kMax> touch{};
  int n_listed = 0;
  int n_found = 0;
};

struct SkinFrame {
  static constexpr int64_t kOneQ12 = 4096;
  SkinTouchList touches;
  bool is_dark = false;
  bool is_light_wrong = false;
  bool has_moved = false;            // the camera against the skin
  int64_t light_q12 = 0;             // of all taxels, relative to rest, minus 1
  int64_t age_q12 = 0;               // light at rest relative to the calibration; 0: unknown
  std::span<const int32_t> ratio{};  // per taxel; empty without taxels
  std::span<const int16_t> glow{};   // brightness above rest; smoothed if there are no taxels
};

// Displacement or position of a patch, the position relative to the pad's centre.
struct FlowPoint {
  int64_t x_q4 = 0;  // um
  int64_t y_q4 = 0;
};

struct Profile {
  static constexpr size_t kRings = 16;
  int64_t fall_q16 = 0;
  int64_t center_x_um = 0;
  int64_t center_y_um = 0;
  std::array<int64_t, kRings> radial_q4{};  // um
  int64_t size_q4 = 0;                      // um
  int64_t lost_1e3 = 0;
  int64_t flow_q4 = 0;                // um
  std::span<const FlowPoint> flow{};  // displacement of each patch
  std::span<const int32_t> fall{};    // smoothed fall of the density at each patch, Q16
};

// The numeric values are those of ContactKind in ruffini.proto.
enum class ContactKind : uint8_t { kUnknown = 0, kPlanar = 1, kHertzian = 2 };

struct ModelledContact {
  static constexpr size_t kInputs = Profile::kRings + 2;
  using Inputs = std::array<int64_t, kInputs>;
  bool is_touched = false;
  bool is_covered = false;     // too many patches are lost
  bool is_over_range = false;  // no model applies: depth, area and hardness are invalid
  bool is_strange = false;     // no model holds: depth, area and hardness are wrong
  bool has_hardness = false;
  ContactKind kind = ContactKind::kUnknown;
  int64_t confidence_1e3 = 0;  // confidence of the kind, 500 to 1000
  int64_t gel_depth_um = 0;
  int64_t press_depth_um = 0;
  int64_t depth_sigma_um = 0;
  int64_t area_um2 = 0;
  int64_t effective_area_um2 = 0;
  int64_t stiffness_pa_um = 0;  // H_m, pascals per micrometre
  int64_t shore_q4 = 0;
  int64_t shore_sigma_q4 = 0;
  int64_t mean_flow_um = 0;                          // magnitude
  int64_t moment_by_flow_unmm = 0;                   // its size
  Validity depth_validity = Validity::kNotMeasured;  // of depths and areas
  Validity hardness_validity = Validity::kNotMeasured;
  Inputs inputs{};  // of the models (stages/contact_model/contact_model.h), in the last touched frame
};

struct HelmholtzSums {
  int64_t curl_free_q4 = 0;                // S_n over the number of patches, um
  int64_t divergence_free_q4 = 0;          // S_t over the number of patches, um
  int64_t twist_urad = 0;                  // from x towards y
  std::span<const FlowPoint> curl_free{};  // of each patch
};

struct TipTouch {
  bool is_touched = false;
  bool is_known = true;     // like what it was fitted on
  bool is_in_range = true;  // no harder than what it was fitted on
  bool has_camera_moved = false;
  int64_t force_un = 0;   // along the tool's axis, into the fingertip
  int64_t travel_um = 0;  // of the tool since it touched
  int64_t x_um = 0;       // of the tool's axis from the fingertip's, in the tool's axes
  int64_t y_um = 0;
  int64_t roll_urad = 0;  // of the fingertip under the tool, about x, then pitch about y
  int64_t pitch_urad = 0;
  int64_t area_um2 = 0;       // of the tool's face; 0: not known, its deviation is above a fifth
  int64_t flat_area_um2 = 0;  // of the wall that lies in the tool's plane; 0: not measured
  int64_t flat_area_sigma_um2 = 0;
  std::array<int64_t, 7> sigma{};      // of the above; of the area um^2
  std::array<int64_t, 3> axis_1e6{};   // t, out of the fingertip
  std::array<int64_t, 3> place_q14{};  // the middle of what is pressed, as a direction from the sphere's
};

// One squeeze of an object (stages/softness/softness.h).
struct Squeeze {
  int64_t n_squeezes = 0;     // up to this one, since the pad was handled
  int64_t n_frames = 0;       // of its rise; 0: no squeeze yet
  int64_t log_share_q16 = 0;  // log2 of the dent's curvature over that of a rigid object
  int64_t log_sigma_q16 = 0;
  int64_t modulus_pa = 0;  // E / (1 - nu^2); 0: not distinguishable from a rigid object
  int64_t low_pa = 0;      // one standard deviation below, and above; high 0: no upper limit
  int64_t high_pa = 0;
};

}  // namespace ruffini
