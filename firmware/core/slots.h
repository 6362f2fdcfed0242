// The data of one frame: what the stages hand to each other and to the encoders.
//
// A slot has one writer among a board's stages (core/stages.cpp lists who reads and who writes what); everybody else has
// a const view of it. A slot is valid until the next frame. All buffers are sized in FramePath::configure.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/difference.h"
#include "image/displacement.h"
#include "image/markers.h"
#include "image/photometric.h"
#include "solve/node_sigma.h"

namespace ruffini {

// Reasons why a result must not be used as it stands; numbers are those of FlagBit in ruffini.proto.
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
// What makes the forces of a frame invalid.
inline constexpr uint32_t kWrongFlags = kFlagNoReference | kFlagMarkersLost | kFlagSaturated | kFlagOverRange |
                                        kFlagDark | kFlagOverexposed | kFlagLight | kFlagFeatures | kFlagOtherPad |
                                        kFlagRepeated | kFlagPicture;

// Numbers are those of Validity in ruffini.proto.
enum class Validity : uint8_t { kNotMeasured = 0, kValid = 1, kUncalibrated = 2, kInvalid = 3 };

// In the order of the table (core/stages.cpp).
enum class StageId : uint8_t {
  kDifference,
  kMarkers,
  kTargets,
  kPhotometric,
  kPoisson,
  kDisplacement,
  kOperator,
  kSupport,
  kWrench,
  kFeatureWrench,
  kContacts,
  kSkin,
  kContactModel,
  kFingertip,
  kHelmholtz,
  kContactDepth,
  kCount
};
inline constexpr size_t kStageCount = static_cast<size_t>(StageId::kCount);

struct FrameState {
  uint32_t flags = 0;
  SaturationCounter saturations;                 // since configure
  std::array<uint64_t, kStageCount> stage_ns{};  // of this frame
  Validity force_xy = Validity::kNotMeasured;
  Validity force_z = Validity::kNotMeasured;
  Validity depth_validity = Validity::kNotMeasured;
  Validity contact_depth = Validity::kNotMeasured;  // of the stage contact_model: depths and areas
  Validity hardness = Validity::kNotMeasured;
  std::array<Validity, 6> wrench_validity{};  // of each component

  struct {
    std::vector<RelativeChange> change;  // planes of B, G and R, height x width each
    std::vector<uint16_t> grey;          // of three channels together, 1/16 levels
    ExposureCounts exposure;
  } difference;
  struct {
    int n_lost = 0;
  } markers;  // the markers themselves: FramePath::markers()
  struct {
    int n_lost = 0;
  } targets;  // the targets themselves: FramePath::targets()
  struct {
    std::vector<CellSlope> slope;  // depth grid
  } photometric;
  struct {
    std::vector<DisplacementUm> depth;  // depth grid; of the stage contact_depth, where there is that
  } poisson;
  struct {
    std::vector<NodeDisplacement> node;  // observed nodes
    std::vector<uint8_t> is_filled;      // 1: x and y rest on lost markers (image/displacement.h)
  } displacement;
  SolvedForces solve;
  struct {
    std::vector<NodeSigma> node;  // observed nodes
    WrenchCovariance wrench;
    bool is_stated = false;     // in this frame: there is an error model, and the second pass ran
    bool is_of_wrench = false;  // the covariance is stated in this frame
    Validity validity = Validity::kNotMeasured;
    Validity wrench_validity = Validity::kNotMeasured;
  } uncertainty;
  struct {
    std::vector<int32_t> node;  // observed nodes, xyz interleaved, 1/64 standard deviation
    Validity validity = Validity::kNotMeasured;
  } residual;  // not measured unless FramePath::find_residual was called
  Wrench wrench;
  ContactList contacts;
  SkinFrame skin;
  Profile profile;  // of the flow, where there is the stage contact_model
  ModelledContact modelled;
  HelmholtzSums helmholtz;  // of the flow, where there is the stage helmholtz
  TipTouch tip;
  struct {
    std::span<const NodeSlip> node;                      // observed nodes
    std::array<ContactSlip, ContactList::kMax> contact;  // in the order of `contacts`
  } slip;
};

}  // namespace ruffini
