#include "store/manifest.h"

#include <string>

namespace ruffini {
namespace {

constexpr int64_t kMaxVersion = 999'999'999'999;
constexpr int64_t kMaxEpoch = 1'000'000'000;

Error refused(const std::string& what) { return {ErrorKind::kRefused, what}; }

}  // namespace

Result<Manifest> read_manifest(const Calibration& calibration) {
  const auto version = calibration.integer("version", 1, kMaxVersion);
  if (!version) return version.error();
  const auto epoch = calibration.integer("security_epoch", 0, kMaxEpoch);
  if (!epoch) return epoch.error();
  return Manifest{version.value(), static_cast<uint32_t>(epoch.value()), calibration.text("allow_older") == "1",
                  calibration.text("allow_jump") == "1"};
}

Status check_epoch(const Manifest& manifest, uint32_t epoch) {
  if (manifest.epoch >= epoch) return Unit{};
  return refused("calibration is of security epoch " + std::to_string(manifest.epoch) + ", this device is at " +
                 std::to_string(epoch) + " and does not go back: use a newer file, or sign it for epoch " +
                 std::to_string(epoch) + " (`ruffini key sign --epoch`)");
}

Status check_succession(const Manifest& manifest, int64_t version, uint32_t epoch) {
  const Status is_fresh = check_epoch(manifest, epoch);
  if (!is_fresh) return is_fresh;
  if (manifest.version < version && !manifest.allows_older) {
    return refused("calibration is of version " + std::to_string(manifest.version) + ", version " +
                   std::to_string(version) +
                   " is in force: use `ruffini cal undo`, or have its owner sign it with --allow-older");
  }
  if (manifest.allows_jump) return Unit{};
  if (manifest.version - version > kMaxVersionStep) {
    return refused("calibration is of version " + std::to_string(manifest.version) + ", more than " +
                   std::to_string(kMaxVersionStep) + " after version " + std::to_string(version) +
                   " that is in force: check the number, or have its owner sign it with --allow-jump");
  }
  if (manifest.epoch - epoch > kMaxEpochStep) {
    return refused("calibration is of security epoch " + std::to_string(manifest.epoch) + ", more than " +
                   std::to_string(kMaxEpochStep) + " after " + std::to_string(epoch) +
                   " of this device: check the number, or have its owner sign it with --allow-jump");
  }
  return Unit{};
}

}  // namespace ruffini
