// Messages of a sensor, in SI units unless a name or comment says otherwise.
//
// The origin is the centre of the undeformed pad's surface, x right and y down in the camera's image, z out of the pad.
// Forces act ON the pad: pressing is negative z. A number may be NaN only if the comment on it or on its struct says
// so; others are as transmitted, whatever the validity. Messages of one camera frame, such as WRENCH and CONTACTS, have
// the same Stamp::frame.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace ruffini::client {

inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

enum class Validity : uint8_t {
  kNotMeasured = 0,  // the sensor cannot measure it, or the stage did not run
  kValid = 1,
  kUncalibrated = 2,  // monotonic, but not in the stated unit
  kInvalid = 3,       // measured, and known to be wrong; also any value unknown to this library
};

// FlagBit of ruffini.proto: reasons against a result, also against one that is VALID
// (docs/how-to/use-forces-for-control.md).
enum Flag : uint32_t {
  kFlagNoReference = 1,
  kFlagUncalibratedXy = 2,
  kFlagUncalibratedZ = 4,
  kFlagMarkersLost = 8,
  kFlagSaturated = 16,
  kFlagOverRange = 32,
  kFlagDark = 64,
  kFlagOverexposed = 128,
  kFlagStale = 256,
  kFlagWindowBorder = 512,
  kFlagLight = 1024,
  kFlagFeatures = 2048,
  kFlagOtherPad = 4096,
  kFlagTemperature = 8192,
  kFlagViewLost = 16384,
  kFlagRepeated = 32768,
  kFlagPicture = 65536,
  kFlagTime = 131072,
  kFlagRestUnverified = 262144,
};
inline constexpr uint32_t kKnownFlags = (kFlagRestUnverified << 1) - 1;

// HealthBit of ruffini.proto, in Status::health: conditions that outlast a frame. All but DEVELOPMENT_KEY, LINK_DEGRADED,
// NETWORK, REFLEX, THROTTLED and CRASHED forbid the use of forces for control.
enum HealthBit : uint32_t {
  kHealthUncalibrated = 1,
  kHealthDevelopmentKey = 2,
  kHealthCameraStalled = 4,
  kHealthLinkDegraded = 8,
  kHealthStoreError = 16,
  kHealthNoReference = 32,
  kHealthSkinAged = 64,
  kHealthTrial = 128,
  kHealthNetwork = 256,
  kHealthReflex = 512,
  kHealthThrottled = 1024,
  kHealthLate = 2048,
  kHealthCrashed = 4096,
  kHealthSafeMode = 8192,
  kHealthZeroLimit = 16384,
  kHealthLight = 32768,
  kHealthUnjudged = 65536,
  kHealthRate = 131072,
};

// ReplyCode of ruffini.proto.
enum ReplyCode : uint32_t {
  kReplyOk = 0,
  kReplyUnknownCommand = 1,
  kReplyBadArgument = 2,
  kReplyBusy = 3,
  kReplyRefused = 4,
  kReplyBadHash = 5,
  kReplyStorage = 6,
  kReplyNotReady = 7,
};

struct Stamp {
  uint64_t capture_us = 0;  // exposure midpoint, monotonic clock of the device
  uint64_t frame = 0;       // number of the camera frame; if every frame is subscribed, gaps are dropped frames
  uint32_t flags = 0;       // mask of Flag
  uint32_t calibration_id = 0;
};

struct Measured {
  double value = kNaN;   // NaN unless VALID
  double as_sent = 0.0;  // transmitted number, even when not VALID: not for control
  Validity validity = Validity::kNotMeasured;
};

struct Wrench {
  Stamp stamp;
  // x, y, z. On a skin z is the sum of the touches' normal forces, not a component: use SkinTouch::normal_force_n.
  std::array<Measured, 3> force_n;
  std::array<Measured, 3> torque_n_m;  // about the origin
  // Covariance of (fx, fy, fz, tx, ty, tz), N and N m; nullopt if it is not VALID: absent does not mean zero. Entries of
  // components that are not VALID mean nothing: of a fingertip's only (fz, fz) counts.
  std::optional<std::array<std::array<double, 6>, 6>> covariance;
};

// Integers as transmitted, even when not VALID, on a grid of n_x x n_y places, x fastest, n_components each.
struct Grid {
  uint32_t n_x = 0;
  uint32_t n_y = 0;
  uint32_t n_components = 0;
  std::vector<int32_t> values;
  [[nodiscard]] size_t n_nodes() const { return size_t{n_x} * n_y; }
};

struct Field {
  Stamp stamp;
  std::array<Validity, 3> validity{};  // of force and displacement along x, y, z
  Validity sigma_validity = Validity::kNotMeasured;
  double force_step_n = 0.0;
  double displacement_step_m = 0.0;
  Grid force_steps;         // in units of force_step_n
  Grid displacement_steps;  // in units of displacement_step_m; empty: not sent
  Grid sigma_steps;         // standard deviation of force, in units of force_step_n; empty: not measured
  Grid slip;                // 0 not pressed, 1 sticks, 2 slips; empty: not measured

  // Values of one node, NaN along axes that are not VALID. Precondition: node < force_steps.n_nodes().
  [[nodiscard]] std::array<double, 3> force_n_at(size_t node) const;
  [[nodiscard]] std::array<double, 3> displacement_m_at(size_t node) const;
  [[nodiscard]] std::array<double, 3> sigma_n_at(size_t node) const;
};

struct Depth {
  Stamp stamp;
  Validity validity = Validity::kNotMeasured;
  double step_m = 0.0;
  uint32_t step_px = 0;  // cell size in pixels of the camera
  double sigma_m = 0.0;  // standard deviation of a touched cell; 0: not stated
  Grid depth_steps;      // in units of step_m, negative where pressed

  // NaN unless VALID. Precondition: cell < depth_steps.n_nodes().
  [[nodiscard]] double depth_m_at(size_t cell) const;
};

// Displacement that the forces do not explain, at each node, in standard deviations: RMS about 1 under any load if pad
// and noise match the calibration. Computed for subscribers only.
struct Residual {
  Stamp stamp;
  Validity validity = Validity::kNotMeasured;
  double step = 0.0;    // standard deviations
  Grid residual_steps;  // in units of `step`, along x, y, z; empty: not measured

  // Residual of one node in standard deviations; NaN unless VALID. Precondition: node < residual_steps.n_nodes().
  [[nodiscard]] std::array<double, 3> sigmas_at(size_t node) const;
};

// kIncipient: a part of the contact's area slips.
enum class SlipState : uint8_t { kNotMeasured = 0, kSticks = 1, kIncipient = 2, kSlides = 3 };

// Parts of a contact that only some boards report. In SkinTouch and ToolTouch all numbers are NaN unless the contact's
// force along z is VALID; a number that was not stated is always NaN.

// A touch of a skin, in the camera's axes.
struct SkinTouch {
  std::array<double, 3> place_m{};         // of its centre on the undeformed skin
  std::array<double, 3> normal_force_n{};  // along the local normal
  double force_sigma_n = kNaN;             // of Contact::force_n[2]
  double center_sigma_m = kNaN;            // of Contact::center_m
};

// A tool that came down along its own axis on a fingertip.
struct ToolTouch {
  std::array<double, 2> place_m{};           // offset of the tool's axis from the fingertip's, in the tool's axes
  double way_m = kNaN;                       // travel of the tool since it touched
  double roll_rad = kNaN, pitch_rad = kNaN;  // of the fingertip under the tool, about x, then about y
  std::array<double, 3> normal_force_n{};    // along the tool's axis, in the camera's axes
  double force_sigma_n = kNaN;               // of Contact::force_n[2]
  std::array<double, 2> place_sigma_m{};
  double way_sigma_m = kNaN, roll_sigma_rad = kNaN, pitch_sigma_rad = kNaN;
  double face_area_sigma_m2 = kNaN;                       // of Contact::area_m2
  double flat_area_m2 = kNaN, flat_area_sigma_m2 = kNaN;  // part of the fingertip in the tool's plane
};

enum class ContactKind : uint8_t { kNotTold = 0, kPlanar = 1, kHertzian = 2 };

// From the motion of the pad's texture in the image. The numbers after a validity are NaN unless it is VALID.
struct ContactModel {
  ContactKind kind = ContactKind::kNotTold;
  double kind_confidence = kNaN;                        // 0.5 to 1; NaN: kind not told
  Validity depth_validity = Validity::kNotMeasured;     // of the next four
  double gel_depth_m = kNaN, gel_depth_sigma_m = kNaN;  // of the gel
  double press_depth_m = kNaN;      // travel of the object since it touched, including its own deformation
  double effective_area_m2 = kNaN;  // of the object's face
  Validity hardness_validity = Validity::kNotMeasured;  // of the next three
  double stiffness_pa_per_m = kNaN;                     // d(normal force / effective area) / d(gel depth)
  double shore_a = kNaN, shore_a_sigma = kNaN;          // hardness of the object
  double mean_flow_m = 0.0;                             // as sent, whatever the validity
  double moment_by_flow_n_m = 0.0;                      // as sent, whatever the validity
};

// Components of the texture's motion, as sent, whatever the validity.
struct FlowParts {
  double curl_free_m = 0.0;        // mean magnitude of the gradient
  double divergence_free_m = 0.0;  // magnitude of the mean of the remainder
  double twist_rad = 0.0;          // from x to y
};

struct Contact {
  uint32_t id = 0;                   // rank in this frame; of a skin it stays with the touch
  double area_m2 = 0.0;              // as sent, whatever the validity; 0: not known
  std::array<double, 2> center_m{};  // centre of pressure, as sent, whatever the validity; skins: unrolled flat
  std::array<Measured, 3> force_n;   // x, y, z; of a skin z along the local normal
  Measured peak_depth_m;             // lowest shift along z, negative: pressed
  SlipState slip_state = SlipState::kNotMeasured;
  // NaN if not measured or not known yet.
  double shear_ratio = kNaN;     // |F_t| / |F_n|
  double friction = kNaN;        // coefficient
  double friction_sigma = kNaN;  // standard deviation of friction
  double slip_share = kNaN;      // share of the contact's area that slips
  double slip_margin_n = kNaN;   // additional shear that the contact can bear

  bool reaches_border = false;  // the pad continues beyond the camera's window: values cover the visible part only
  std::optional<SkinTouch> skin;
  std::optional<ToolTouch> tool;
  std::optional<ContactModel> model;
  std::optional<FlowParts> flow_parts;
};

// The last squeeze of an object, until the next one. Numbers are NaN unless VALID. An infinite modulus_pa means a rigid
// object, an infinite high_pa no upper limit.
struct Softness {
  Validity validity = Validity::kNotMeasured;
  uint32_t squeeze = 0;      // number of squeezes since rest was learned, this one included
  uint32_t n_frames = 0;     // frames while the force rose, over which the modulus is averaged
  double modulus_pa = kNaN;  // E / (1 - nu^2)
  double low_pa = kNaN;      // one standard deviation below
  double high_pa = kNaN;     // one standard deviation above
  double log2_share = kNaN;  // log2 of (curvature of the dent / that by a rigid object): compare objects by it
  double log2_share_sigma = kNaN;
};

struct Contacts {
  Stamp stamp;
  uint32_t n_found = 0;  // all contacts found; `contacts` holds the largest, largest first
  std::vector<Contact> contacts;
  std::optional<Softness> softness;  // absent: the board has no stage softness
};

// Markers, patches or targets in the image, without validity: places in the image are measured before any force.
struct Markers {
  Stamp stamp;
  double step_px = 0.0;
  Grid displacement;          // x, y relative to rest, in steps of step_px
  Grid rest;                  // x, y at rest, in the same steps; empty: not sent
  Grid quality;               // 255 / (1 + (expected error / 0.1 px)^2), 0 lost; empty: no quality
  Grid area;                  // of targets: change relative to rest, 1/256 square pixel; empty: no targets
  std::vector<bool> is_lost;  // true: estimated from neighbours
};

// Result of a learned network for a frame. It arrives later than the frame's other messages, and not for every frame.
struct Learned {
  Stamp stamp;                                              // of the processed frame
  bool is_valid = false;                                    // false: no number, or outside the training range
  std::vector<std::pair<std::string, int64_t>> quantities;  // names with their units, e.g. "force_un"
  double took_s = 0.0;                                      // of the network alone
  double latency_s = 0.0;                                   // from mid-exposure to the result
  double period_s = 0.0;                                    // since the previous result; 0: first result
};

struct SensorInfo {
  uint32_t sensor = 0;  // Packet::sensor
  std::string board, product;
  uint32_t n_x = 0, n_y = 0;              // nodes of FIELD
  std::array<double, 2> grid_origin_m{};  // x, y of the first node
  std::array<double, 2> grid_step_m{};    // distance between nodes along x, y
  std::vector<std::string> not_measured;  // quantities that this board cannot measure, e.g. "torque_z"
  bool is_calibrated = false;             // the next three describe the calibration
  bool has_development_key = false;       // signed with the public development key: anybody can make one
  bool is_on_trial = false;               // not confirmed yet: a restart restores the previous one
  std::string calibration_summary;        // checks of its report: "passed", or which failed; empty: not judged

  // x, y of FIELD's node on the undeformed pad.
  [[nodiscard]] std::array<double, 2> position_m_at(size_t node) const;
};

struct Hello {
  uint32_t protocol_version = 0;
  std::string firmware_version, device_serial;
  uint32_t session_id = 0;  // changes with every start of the device
  bool needs_key = false;   // zero must be signed, which `ruffini` can do
  std::vector<SensorInfo> sensors;
};

struct Status {
  uint64_t uptime_us = 0, frames_captured = 0, frames_processed = 0;
  double frame_rate_hz = 0.0;
  uint64_t replaced_frames = 0;  // replaced by newer frames before they were processed
  uint64_t invalid_frames = 0;   // damaged, of another size or exposure, or unpaired
  uint64_t dropped_packets = 0;  // messages that the host did not read in time
  uint32_t health = 0;           // mask of HealthBit; 0: no problem
  std::vector<std::pair<std::string, double>> temperatures_c;
};

struct Event {
  uint64_t time_us = 0;
  uint32_t severity = 0;  // 0 info, 1 warning, 2 error
  std::string what, text;
};

struct Reply {
  uint32_t request_id = 0;
  uint32_t code = 0;  // ReplyCode
  std::string text;   // for people
};

// Answer to Encoder::ask_time. If the host's clock, in us, is t_request at the request and t_answer at the answer, host
// minus device is (t_request + t_answer - received_us - sent_us) / 2. Its error is at most half of
// (t_answer - t_request) - (sent_us - received_us), plus the drift of the clocks since (below 300 ppm).
struct Time {
  uint64_t token = 0;
  uint64_t received_us = 0;  // the request, on the clock of Stamp::capture_us
  uint64_t sent_us = 0;      // the answer, on the same clock
};

}  // namespace ruffini::client
