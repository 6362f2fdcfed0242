// Data of one frame: the slots through which stages pass data to each other and to the encoders.
//
// A slot has one writer among a board's stages. A later stage may be declared to amend it; all others have a const view
// (core/stages.cpp lists who reads, writes and amends each slot). A slot keeps its content until its writer runs again:
// a stage before the writer reads the previous frame's (but not its pictures, if a later segment receives them). All
// buffers are sized in FramePath::configure.
#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/difference.h"
#include "image/displacement.h"
#include "image/light.h"
#include "image/markers.h"
#include "image/photometric.h"
#include "image/rest.h"
#include "image/targets.h"
#include "solve/node_sigma.h"

namespace ruffini {

// Reasons for which a result must not be used as it is. The numeric values are those of FlagBit in ruffini.proto.
enum Flag : uint32_t {
  kFlagNoReference = 1,
  kFlagUncalibratedXy = 2,
  kFlagUncalibratedZ = 4,
  kFlagMarkersLost = 8,
  kFlagSaturated = 16,
  kFlagOverRange = 32,
  kFlagDark = 64,
  kFlagOverexposed = 128,
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
// Flags that make the forces of a frame invalid.
inline constexpr uint32_t kWrongFlags = kFlagNoReference | kFlagMarkersLost | kFlagSaturated | kFlagOverRange |
                                        kFlagDark | kFlagOverexposed | kFlagLight | kFlagFeatures | kFlagOtherPad |
                                        kFlagRepeated | kFlagPicture;

// Validity of a result in a frame with these flags. Without calibration its unit is not that of the calibrated
// quantity.
[[nodiscard]] constexpr Validity validity_of(uint32_t flags, bool is_measured, bool is_calibrated = true) {
  if (!is_measured) return Validity::kNotMeasured;
  if ((flags & kWrongFlags) != 0) return Validity::kInvalid;
  return is_calibrated ? Validity::kValid : Validity::kUncalibrated;
}

// Capacity for the stages that a board lists, and for the rows of the table (core/stages.cpp), which checks both.
inline constexpr size_t kMaxStages = 24;
inline constexpr size_t kMaxRows = 26;
inline constexpr size_t kMaxSegments = 6;  // core/stages.h

// What a stage's features are, inputs of a wrench; stated once, in the stage's row (core/stages.cpp).
struct FeatureSort {
  std::string_view name;        // of the calibration's `wrench.features`; empty: the stage writes none
  const char* unit = "";        // of one step
  bool varies_by_lamp = false;  // with the light: the light stage follows the lamps on boards with such features
};

struct FrameState {
  uint32_t flags = 0;
  SaturationCounter saturations;              // since configure()
  std::array<uint64_t, kMaxRows> stage_ns{};  // of this frame, by row of the table

  struct {
    std::vector<RelativeChange> change;  // planes of B, G and R, height x width each
    std::vector<uint16_t> grey;          // sum of three channels, 1/16 levels
    ExposureCounts exposure;
  } difference;
  struct {
    Rest::Gain gain = Rest::unit_gain();  // followed gain relative to rest
    LightLevel level{};                   // of this frame
    bool is_drifting = false;
  } light;
  struct {
    // One of several views in a frame ([markers] layout "views").
    struct View {
      int n_low_confidence = 0;  // markers that were there at rest and are lost, or have low confidence
      bool was_seen_at_rest = false;
    };
    std::vector<Marker> marker;
    std::vector<View> view;
    int n_lost = 0;
    int n_at_rest = 0;

    // True if a view has lost too many markers, or never saw them.
    [[nodiscard]] bool is_blind(size_t i, int64_t max_lost) const {
      return !view[i].was_seen_at_rest || view[i].n_low_confidence > max_lost;
    }
  } markers;
  struct {
    std::vector<Target> target;  // empty without the stage
    std::vector<Marker> mark;    // the targets as markers, because they hide the surface
    int n_lost = 0;
  } targets;
  // Inputs of a wrench, as changes relative to rest.
  struct {
    FeatureSort sort;
    std::vector<int32_t> value;
    // Of values that are planes over a grid on the pad, plane by plane; 0 planes: of others
    int n_planes = 0;
    GridSize cells;
  } features;
  struct {
    std::vector<CellSlope> slope;       // depth grid
    std::vector<DisplacementUm> depth;  // depth grid, if is_of_depth
    bool is_balanced = false;           // the level of the frame's light has been subtracted
    bool is_of_depth = false;           // the calibration converts colours directly to depth; there is no slope
    bool is_foreign_optics = false;     // the calibration is for other optics: depth for display, not for forces
  } photometric;
  struct {
    std::vector<DisplacementUm> cell;
    GridSize grid;
    int step_px = 1;          // cell size in pixels of the image
    int64_t sigma_um = 0;     // of a touched cell; 0: unknown
    bool is_trusted = false;  // may be used for forces
    Validity validity = Validity::kNotMeasured;
  } depth;
  struct {
    std::vector<NodeDisplacement> node;  // observed nodes
    std::vector<uint8_t> filled;         // what is not the node's own (base/filled.h)
    bool has_depth = false;              // u_z is measured and may be used for forces
    int64_t zero_moved_nm = 0;           // creep of the followed zero (estimators/zero_follower.h)
    bool is_zero_at_limit = false;
  } displacement;
  SolvedForces solve;
  // Validity of forces along the surface and normal to it, at the nodes or for the touches of a skin or a fingertip.
  struct {
    Validity xy = Validity::kNotMeasured;
    Validity z = Validity::kNotMeasured;
  } force;
  struct {
    std::vector<NodeSigma> node;  // observed nodes
    bool is_stated = false;       // in this frame: there is an error model, and the second pass ran
    Validity validity = Validity::kNotMeasured;
  } uncertainty;
  struct {
    std::vector<int32_t> node;  // observed nodes, xyz interleaved, 1/64 standard deviation
    Validity validity = Validity::kNotMeasured;
  } residual;  // measured only on request (Stage::compute)
  struct {
    Wrench sum;
    std::array<Validity, 6> validity{};  // of each component
    bool is_beyond_noise = false;        // for features without a field: beyond 5 standard deviations
  } wrench;
  struct {
    WrenchCovariance wrench;
    bool is_stated = false;  // in this frame
    Validity validity = Validity::kNotMeasured;
  } covariance;
  ContactList contacts;
  struct {
    std::span<const NodeSlip> node;                      // observed nodes
    std::array<ContactSlip, ContactList::kMax> contact;  // in the order of `contacts`
  } slip;
  SkinFrame skin;
  Profile profile;
  ModelledContact modelled;
  HelmholtzSums helmholtz;
  TipTouch tip;
  struct {
    int32_t level_cdb = 0;  // hundredths of a decibel relative to one grey level, rms
    Validity validity = Validity::kNotMeasured;
  } vibration;
  struct {
    Squeeze squeeze;
    Validity validity = Validity::kNotMeasured;
  } softness;
};

enum class Slot : uint8_t {
  kDifference,
  kLight,
  kMarkers,
  kTargets,
  kFeatures,
  kSlope,
  kDepth,
  kDisplacement,
  kNodeForces,
  kForceValidity,
  kNodeSigma,
  kResidual,
  kWrench,
  kCovariance,
  kContacts,
  kSlip,
  kSkin,
  kProfile,
  kContactModel,
  kHelmholtz,
  kToolTouch,
  kVibration,
  kSoftness,
  kCount
};
inline constexpr size_t kSlotCount = static_cast<size_t>(Slot::kCount);

[[nodiscard]] constexpr std::string_view slot_name(Slot slot) {
  constexpr std::array<std::string_view, kSlotCount> kNames = {
      "difference",    "light",        "markers",     "targets",        "features",   "slope",
      "depth",         "displacement", "node_forces", "force_validity", "node_sigma", "residual",
      "wrench",        "covariance",   "contacts",    "slip",           "skin",       "profile",
      "contact_model", "helmholtz",    "tool_touch",  "vibration",      "softness"};
  return kNames[static_cast<size_t>(slot)];
}

class SlotSet {
 public:
  constexpr SlotSet() = default;
  constexpr SlotSet(std::initializer_list<Slot> slots) {
    for (const Slot slot : slots) add(slot);
  }
  constexpr void add(Slot slot) { bits_ |= bit(slot); }
  [[nodiscard]] constexpr bool has(Slot slot) const { return (bits_ & bit(slot)) != 0; }
  [[nodiscard]] constexpr bool has_all(SlotSet other) const { return (other.bits_ & ~bits_) == 0; }
  [[nodiscard]] constexpr bool has_any(SlotSet other) const { return (other.bits_ & bits_) != 0; }
  [[nodiscard]] constexpr SlotSet operator|(SlotSet other) const { return SlotSet(bits_ | other.bits_); }
  [[nodiscard]] constexpr SlotSet without(SlotSet other) const { return SlotSet(bits_ & ~other.bits_); }
  [[nodiscard]] constexpr SlotSet operator&(SlotSet other) const { return SlotSet(bits_ & other.bits_); }
  constexpr bool operator==(const SlotSet&) const = default;

 private:
  constexpr explicit SlotSet(uint32_t bits) : bits_(bits) {}
  static constexpr uint32_t bit(Slot slot) { return uint32_t{1} << static_cast<unsigned>(slot); }
  uint32_t bits_ = 0;
};
static_assert(kSlotCount <= 32);

// Returns the slot's data; const if `state` is.
template <Slot slot, typename State>
[[nodiscard]] constexpr auto& slot_of(State& state) {
  if constexpr (slot == Slot::kDifference) return state.difference;
  if constexpr (slot == Slot::kLight) return state.light;
  if constexpr (slot == Slot::kMarkers) return state.markers;
  if constexpr (slot == Slot::kTargets) return state.targets;
  if constexpr (slot == Slot::kFeatures) return state.features;
  if constexpr (slot == Slot::kSlope) return state.photometric;
  if constexpr (slot == Slot::kDepth) return state.depth;
  if constexpr (slot == Slot::kDisplacement) return state.displacement;
  if constexpr (slot == Slot::kNodeForces) return state.solve;
  if constexpr (slot == Slot::kForceValidity) return state.force;
  if constexpr (slot == Slot::kNodeSigma) return state.uncertainty;
  if constexpr (slot == Slot::kResidual) return state.residual;
  if constexpr (slot == Slot::kWrench) return state.wrench;
  if constexpr (slot == Slot::kCovariance) return state.covariance;
  if constexpr (slot == Slot::kContacts) return state.contacts;
  if constexpr (slot == Slot::kSlip) return state.slip;
  if constexpr (slot == Slot::kSkin) return state.skin;
  if constexpr (slot == Slot::kProfile) return state.profile;
  if constexpr (slot == Slot::kContactModel) return state.modelled;
  if constexpr (slot == Slot::kHelmholtz) return state.helmholtz;
  if constexpr (slot == Slot::kToolTouch) return state.tip;
  if constexpr (slot == Slot::kVibration) return state.vibration;
  if constexpr (slot == Slot::kSoftness) return state.softness;
}

template <Slot slot>
using SlotData = std::remove_reference_t<decltype(slot_of<slot>(std::declval<FrameState&>()))>;

// True if a frame with these results shows contact.
[[nodiscard]] inline bool shows_touch(const SlotData<Slot::kContacts>& contacts, const SlotData<Slot::kWrench>& wrench,
                                      const SlotData<Slot::kToolTouch>& tip) {
  return contacts.n_found > 0 || tip.is_touched || wrench.is_beyond_noise;
}

// Gives a stage its slots at construction: const to read, mutable to write or amend. The slots requested must be those
// declared in the table (tests/cpp/core/stages_test.cpp).
class SlotAccess {
 public:
  explicit SlotAccess(FrameState& state) : state_(state) {}

  template <Slot slot>
  [[nodiscard]] const auto& read() {
    read_.add(slot);
    return slot_of<slot>(std::as_const(state_));
  }
  template <Slot slot>
  [[nodiscard]] auto& write() {
    written_.add(slot);
    return slot_of<slot>(state_);
  }
  template <Slot slot>
  [[nodiscard]] auto& amend() {
    amended_.add(slot);
    return slot_of<slot>(state_);
  }
  [[nodiscard]] SlotSet all_read() const { return read_; }
  [[nodiscard]] SlotSet all_written() const { return written_; }
  [[nodiscard]] SlotSet all_amended() const { return amended_; }

 private:
  FrameState& state_;
  SlotSet read_;
  SlotSet written_;
  SlotSet amended_;
};

}  // namespace ruffini
