#include "capture/libcamera_metadata.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>

namespace ruffini {
namespace {

namespace lc = libcamera;

int64_t clock_ns(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

bool is_within(double value, double wanted, double part) { return std::abs(value - wanted) <= part * wanted; }

}  // namespace

YuvRule rule_of(const std::optional<lc::ColorSpace>& space) {
  if (!space) return kFull601;
  const bool is_full = space->range == lc::ColorSpace::Range::Full;
  if (space->ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec709) return is_full ? kFull709 : kLimited709;
  return is_full ? kFull601 : kLimited601;
}

// libcamera stamps the start of the first row's exposure with the clock that includes suspend; some pipelines use the
// kernel's monotonic time. A stamp ahead of the latter must be the former.
uint64_t middle_us(const lc::ControlList& said, const lc::FrameMetadata& about) {
  int64_t stamp_ns = said.get(lc::controls::SensorTimestamp).value_or(static_cast<int64_t>(about.timestamp));
  const int64_t now_ns = clock_ns(CLOCK_MONOTONIC);
  if (stamp_ns <= 0) stamp_ns = now_ns;
  if (stamp_ns > now_ns) stamp_ns -= clock_ns(CLOCK_BOOTTIME) - now_ns;
  const int64_t exposure_us = said.get(lc::controls::ExposureTime).value_or(0);
  return static_cast<uint64_t>(std::max<int64_t>(stamp_ns / 1'000 + exposure_us / 2, 0));
}

// Describes how the frame's reported settings differ from [exposure]; settings that are not reported are not checked.
std::string drift_of(const lc::ControlList& said, const ExposureSettings& asked) {
  if (!asked.is_manual()) return {};
  // Step sizes of a sensor: rows of exposure, sixteenths of gain.
  constexpr double kPart = 0.02;
  if (const auto time = said.get(lc::controls::ExposureTime);
      time && !is_within(*time, static_cast<double>(asked.time_us), kPart)) {
    return "an exposure of " + std::to_string(*time) + " us, asked " + std::to_string(asked.time_us);
  }
  if (const auto gain = said.get(lc::controls::AnalogueGain);
      gain && !is_within(double{*gain} * 1'000, static_cast<double>(asked.gain_1e3), 2 * kPart)) {
    return "a gain of " + std::to_string(*gain) + ", asked " + std::to_string(asked.gain_1e3) + " thousandths";
  }
  const auto colours = said.get(lc::controls::ColourGains);
  if (colours && asked.white_kelvin == 0 &&
      (!is_within(double{(*colours)[0]} * 1'000, static_cast<double>(asked.red_1e3), kPart) ||
       !is_within(double{(*colours)[1]} * 1'000, static_cast<double>(asked.blue_1e3), kPart))) {
    return "colour gains of " + std::to_string((*colours)[0]) + " (red), " + std::to_string((*colours)[1]) +
           " (blue), asked " + std::to_string(asked.red_1e3) + ", " + std::to_string(asked.blue_1e3) + " thousandths";
  }
  return {};
}

}  // namespace ruffini
