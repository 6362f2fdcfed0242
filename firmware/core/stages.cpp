#include "core/stages.h"

#include <algorithm>
#include <array>

#include "core/hand_over.h"

namespace ruffini {

// In stages/<name>/.
StagePointer make_difference(const StageContext& context);
StagePointer make_light(const StageContext& context);
StagePointer make_markers(const StageContext& context);
StagePointer make_targets(const StageContext& context);
StagePointer make_picture_features(const StageContext& context);
StagePointer make_spot_intensities(const StageContext& context);
StagePointer make_photometric(const StageContext& context);
StagePointer make_poisson(const StageContext& context);
StagePointer make_depth_moments(const StageContext& context);
StagePointer make_displacement(const StageContext& context);
StagePointer make_zero(const StageContext& context);
StagePointer make_depth_validity(const StageContext& context);
StagePointer make_operator(const StageContext& context);
StagePointer make_support(const StageContext& context);
StagePointer make_wrench(const StageContext& context);
StagePointer make_feature_wrench(const StageContext& context);
StagePointer make_contacts(const StageContext& context);
StagePointer make_skin(const StageContext& context);
StagePointer make_contact_model(const StageContext& context);
StagePointer make_fingertip(const StageContext& context);
StagePointer make_helmholtz(const StageContext& context);
StagePointer make_contact_depth(const StageContext& context);
StagePointer make_vibration(const StageContext& context);
StagePointer make_softness(const StageContext& context);
StagePointer make_uncertainty(const StageContext& context);

namespace {

using enum Slot;

constexpr auto kTable = std::to_array<StageEntry>({
    {.name = "difference",
     .reads = {},
     .reads_if_written = {},
     .writes = {kDifference},
     .amends = {},
     .sections = "",
     .kind = "dark",
     .part_of = "",
     .make = make_difference},
    {.name = "markers",
     .reads = {kDifference},
     .reads_if_written = {},
     .writes = {kMarkers, kFeatures},
     .amends = {},
     .sections = "markers",
     .kind = "camera",
     .part_of = "",
     .features = {.name = "markers", .unit = "1/65536 px"},
     .make = make_markers},
    {.name = "targets",
     .reads = {kDifference},
     .reads_if_written = {},
     .writes = {kTargets, kFeatures},
     .amends = {},
     .sections = "targets",
     .kind = "",
     .part_of = "",
     .features = {.name = "targets", .unit = "1/65536 px, areas 1/256 px^2"},
     .make = make_targets},
    {.name = "picture_features",
     .reads = {kDifference},
     .reads_if_written = {},
     .writes = {kFeatures},
     .amends = {},
     .sections = "picture_features",
     .kind = "",
     .part_of = "",
     .features = {.name = "picture", .unit = "1/65536 of rest", .varies_by_lamp = true},
     .make = make_picture_features},
    {.name = "spot_intensities",
     .reads = {kDifference},
     .reads_if_written = {},
     .writes = {kFeatures},
     .amends = {},
     .sections = "markers",
     .kind = "",
     .part_of = "",
     .features = {.name = "spots", .unit = "1/65536 of rest"},
     .make = make_spot_intensities},
    {.name = "light",
     .reads = {kDifference},
     .reads_if_written = {kMarkers, kTargets, kSlope},
     .writes = {kLight},
     .amends = {},
     .sections = "",
     .kind = "photometric",
     .part_of = "difference",
     .amends_rest = true,
     .make = make_light},
    {.name = "photometric",
     .reads = {kDifference},
     .reads_if_written = {kLight, kMarkers, kTargets},
     .writes = {kSlope},
     .amends = {},
     .sections = "depth",
     .kind = "photometric camera",
     .part_of = "",
     .make = make_photometric},
    {.name = "poisson",
     .reads = {kSlope},
     .reads_if_written = {},
     .writes = {kDepth},
     .amends = {},
     .sections = "window depth",
     .kind = "photometric camera gauge",
     .part_of = "",
     .make = make_poisson},
    {.name = "depth_moments",
     .reads = {kDepth},
     .reads_if_written = {},
     .writes = {kFeatures},
     .amends = {},
     .sections = "window depth",
     .kind = "camera",
     .part_of = "",
     .features = {.name = "depth", .unit = "2^-14 um, area 2^-24"},
     .make = make_depth_moments},
    {.name = "displacement",
     .reads = {kMarkers},
     .reads_if_written = {},
     .writes = {kDisplacement},
     .amends = {kDepth},
     .sections = "grid window depth",
     .kind = "photometric camera gauge marker_depth",
     .part_of = "",
     .make = make_displacement},
    {.name = "zero",
     .reads = {kDisplacement},
     .reads_if_written = {kContacts, kWrench, kToolTouch},
     .writes = {},
     .amends = {kDisplacement},
     .sections = "",
     .kind = "",
     .part_of = "displacement",
     .make = make_zero},
    {.name = "operator",
     .reads = {kDisplacement},
     .reads_if_written = {kLight},
     .writes = {kNodeForces, kForceValidity},
     .amends = {},
     .sections = "grid window contact field",
     .kind = "operator contact",
     .part_of = "",
     .make = make_operator},
    {.name = "support",
     .reads = {kNodeForces},
     .reads_if_written = {kDisplacement},
     .writes = {kResidual},
     .amends = {kNodeForces},
     .sections = "grid window contact field",
     .kind = "support finite_strain relaxation contact",
     .part_of = "",
     .make = make_support},
    {.name = "wrench",
     .reads = {kNodeForces},
     .reads_if_written = {kDisplacement, kForceValidity},
     .writes = {kWrench},
     .amends = {},
     .sections = "grid window field",
     .kind = "",
     .part_of = "",
     .make = make_wrench},
    {.name = "feature_wrench",
     .reads = {kFeatures},
     .reads_if_written = {kMarkers},
     .writes = {kWrench, kCovariance},
     .amends = {},
     .sections = "",
     .kind = "wrench",
     .part_of = "",
     .make = make_feature_wrench},
    {.name = "softness",
     .reads = {kFeatures, kWrench, kCovariance},
     .reads_if_written = {},
     .writes = {kSoftness},
     .amends = {},
     .sections = "picture_features",
     .kind = "softness",
     .part_of = "",
     .make = make_softness},
    {.name = "contacts",
     .reads = {kNodeForces},
     .reads_if_written = {kDisplacement, kForceValidity},
     .writes = {kContacts, kSlip},
     .amends = {},
     .sections = "grid window contact field",
     .kind = "",
     .part_of = "",
     .make = make_contacts},
    {.name = "skin",
     .reads = {},
     .reads_if_written = {},
     .writes = {kSkin, kContacts, kWrench, kForceValidity},
     .amends = {},
     .sections = "skin",
     .kind = "skin",
     .part_of = "",
     .make = make_skin},
    {.name = "contact_model",
     .reads = {kMarkers},
     .reads_if_written = {kWrench},
     .needs_one = true,
     .writes = {kProfile, kContactModel, kContacts},
     .amends = {},
     .sections = "markers",
     .kind = "contact_model",
     .part_of = "",
     .make = make_contact_model},
    {.name = "fingertip",
     .reads = {kMarkers},
     .reads_if_written = {},
     .writes = {kToolTouch, kContacts, kWrench, kCovariance, kForceValidity},
     .amends = {},
     .sections = "markers",
     .kind = "fingertip",
     .part_of = "",
     .make = make_fingertip},
    {.name = "helmholtz",
     .reads = {kProfile},
     .reads_if_written = {},
     .writes = {kHelmholtz},
     .amends = {},
     .sections = "markers",
     .kind = "",
     .part_of = "",
     .make = make_helmholtz},
    {.name = "contact_depth",
     .reads = {kProfile, kContactModel},
     .reads_if_written = {},
     .writes = {kDepth},
     .amends = {},
     .sections = "markers depth",
     .kind = "contact_depth",
     .part_of = "",
     .make = make_contact_depth},
    {.name = "vibration",
     .reads = {kDifference, kContacts},
     .reads_if_written = {},
     .writes = {kVibration},
     .amends = {},
     .sections = "",
     .kind = "",
     .part_of = "",
     .make = make_vibration},
    {.name = "uncertainty",
     .reads = {kNodeForces},
     .reads_if_written = {kDisplacement, kWrench, kContacts},
     .writes = {kNodeSigma, kCovariance},
     .amends = {},
     .sections = "",
     .kind = "support",
     .part_of = "support",
     .make = make_uncertainty},
    // Last: only the last segment knows all flags
    {.name = "depth_validity",
     .reads = {kDepth, kSlope},
     .reads_if_written = {},
     .writes = {},
     .amends = {kDepth},
     .sections = "",
     .kind = "",
     .part_of = "poisson",
     .make = make_depth_validity},
});
static_assert(kTable.size() <= kMaxRows);
static_assert(std::count_if(kTable.begin(), kTable.end(), [](const StageEntry& e) { return e.part_of.empty(); }) <=
              ptrdiff_t{kMaxStages});

bool is_listed(std::span<const std::string> stages, const StageEntry& entry) {
  const std::string_view name = entry.part_of.empty() ? entry.name : entry.part_of;
  return std::find(stages.begin(), stages.end(), name) != stages.end();
}

std::string listed_name(const StageEntry& entry) {
  return std::string(entry.part_of.empty() ? entry.name : entry.part_of);
}

bool are_in_order(std::span<const std::string> stages) {
  size_t next = 0;
  for (const std::string& stage : stages) {
    const size_t row = stage_row(stage);
    if (row < next || row == kTable.size()) return false;
    next = row + 1;
  }
  return !stages.empty();
}

// "a", "a or b", "a, b or c"
std::string any_of(const std::vector<std::string>& names) {
  std::string out;
  for (size_t i = 0; i < names.size(); ++i) {
    if (i > 0) out += i + 1 == names.size() ? " or " : ", ";
    out += names[i];
  }
  return out;
}

// The stages before this one that write any of these slots.
std::vector<std::string> writers_before(const StageEntry& reader, SlotSet slots) {
  std::vector<std::string> out;
  for (const StageEntry* entry = kTable.data(); entry != &reader; ++entry) {
    if (entry->part_of.empty() && entry->writes.has_any(slots)) out.emplace_back(entry->name);
  }
  return out;
}

Slot first_of(SlotSet slots) {
  size_t i = 0;
  while (!slots.has(static_cast<Slot>(i))) ++i;
  return static_cast<Slot>(i);
}

std::string lacks(const StageEntry& entry, SlotSet slots) {
  return "stage " + std::string(entry.name) + " needs the stage " + any_of(writers_before(entry, slots));
}

}  // namespace

std::span<const StageEntry> stage_table() { return kTable; }

size_t stage_row(std::string_view name) {
  const auto is_it = [&](const StageEntry& each) { return each.name == name && each.part_of.empty(); };
  return static_cast<size_t>(std::find_if(kTable.begin(), kTable.end(), is_it) - kTable.begin());
}

std::vector<std::string> stage_names() {
  std::vector<std::string> out;
  for (const StageEntry& entry : kTable) {
    if (entry.part_of.empty()) out.emplace_back(entry.name);
  }
  return out;
}

bool is_section_read(std::span<const std::string> stages, std::string_view section) {
  const auto reads = [&](const StageEntry& entry) {
    const std::string all = " " + std::string(entry.sections) + " ";
    return is_listed(stages, entry) && all.find(" " + std::string(section) + " ") != std::string::npos;
  };
  return std::any_of(kTable.begin(), kTable.end(), reads);
}

std::vector<size_t> segments_of(std::span<const std::string> stages) {
  std::vector<size_t> out(kTable.size());
  // The last row that changes each slot; 0: none, as the first one writes Difference, which no other changes.
  std::array<size_t, kSlotCount> last_change{};
  std::array<size_t, kSlotCount> writer{};
  size_t earliest_end = 0;  // the row up to which the current segment reaches at least
  for (size_t row = 0; row < kTable.size(); ++row) {
    if (!is_listed(stages, kTable[row])) continue;
    if (kTable[row].amends_rest) earliest_end = row;
    for (size_t i = 0; i < kSlotCount; ++i) {
      const auto slot = static_cast<Slot>(i);
      if (kTable[row].writes.has(slot)) writer[i] = row;
      if ((kTable[row].writes | kTable[row].amends).has(slot)) last_change[i] = row;
    }
  }
  bool can_hand_over = true;
  bool is_first = true;
  size_t segment = 0;
  for (size_t row = 0; row < kTable.size(); ++row) {
    const StageEntry& entry = kTable[row];
    out[row] = segment;
    if (!is_listed(stages, entry)) continue;
    if (!is_first && row > earliest_end && can_hand_over && segment + 1 < kMaxSegments) out[row] = ++segment;
    is_first = false;
    can_hand_over = can_hand_over && kHandedOver.has_all(entry.writes | entry.amends);
    for (size_t i = 0; i < kSlotCount; ++i) {
      const bool reads = (entry.reads | entry.reads_if_written | entry.amends).has(static_cast<Slot>(i));
      if (reads && writer[i] > row) earliest_end = std::max(earliest_end, last_change[i]);
    }
  }
  return out;
}

std::string refuse_stages(std::span<const std::string> stages) {
  if (!are_in_order(stages)) {
    std::string list;
    for (const std::string& name : stage_names()) list += (list.empty() ? "" : ", ") + name;
    return "pipeline.stages must be some of " + list + ", in this order";
  }
  std::array<const StageEntry*, kSlotCount> writer{};
  SlotSet written;
  for (const StageEntry& entry : kTable) {
    if (!is_listed(stages, entry)) continue;
    for (size_t i = 0; i < kSlotCount; ++i) {
      const auto slot = static_cast<Slot>(i);
      if (entry.reads.has(slot) && !written.has(slot)) return lacks(entry, {slot});
    }
    if (entry.needs_one && !written.has_any(entry.reads_if_written)) return lacks(entry, entry.reads_if_written);
    if (written.has_any(entry.writes)) {
      const Slot slot = first_of(written & entry.writes);
      return "stages " + listed_name(*writer[static_cast<size_t>(slot)]) + " and " + listed_name(entry) +
             " both write the slot " + std::string(slot_name(slot)) + ": leave one of them out";
    }
    for (size_t i = 0; i < kSlotCount; ++i) {
      if (entry.writes.has(static_cast<Slot>(i))) writer[i] = &entry;
    }
    written = written | entry.writes;
  }
  return {};
}

}  // namespace ruffini
