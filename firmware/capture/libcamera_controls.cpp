#include "capture/libcamera_controls.h"

#include <array>
#include <cstdint>
#include <string>

namespace ruffini {
namespace {

namespace lc = libcamera;

const lc::ControlId* find(const lc::Camera& camera, const std::string& name) {
  for (const auto& [id, info] : camera.controls()) {
    if (id->name() == name) return id;
  }
  return nullptr;
}

// Adds a value of [exposure]; appends problems to `problem`. A USB camera silently takes its nearest value instead of
// one that it does not support.
template <typename T>
void ask_number(const lc::Camera& camera, const char* name, T number, bool has_limits, lc::ControlList& out,
                std::string& problem) {
  if (!add_control(camera, name, lc::ControlValue(number), out)) {
    problem += std::string(" ") + name;
    return;
  }
  const lc::ControlInfo& info = camera.controls().at(find(camera, name));
  if (has_limits && (number < info.min().get<T>() || number > info.max().get<T>())) {
    problem += std::string(" ") + name + " " + std::to_string(number) + ", only " + info.toString();
  }
}

}  // namespace

bool add_control(const lc::Camera& camera, const char* name, const lc::ControlValue& value, lc::ControlList& out) {
  const lc::ControlId* id = find(camera, name);
  if (id != nullptr) out.set(id->id(), value);
  return id != nullptr;
}

Status add_exposure_controls(const lc::Camera& camera, const ExposureSettings& exposure, lc::ControlList& out) {
  if (!exposure.is_manual()) return Unit{};
  // Up to 0.4 one switch for both; from 0.5 on a mode for each (1: manual).
  add_control(camera, "AeEnable", lc::ControlValue(false), out);
  add_control(camera, "ExposureTimeMode", lc::ControlValue(int32_t{1}), out);
  add_control(camera, "AnalogueGainMode", lc::ControlValue(int32_t{1}), out);
  add_control(camera, "AwbEnable", lc::ControlValue(false), out);
  const bool is_usb = exposure.white_kelvin != 0;
  std::string problem;
  ask_number(camera, "ExposureTime", static_cast<int32_t>(exposure.time_us), is_usb, out, problem);
  ask_number(camera, "AnalogueGain", static_cast<float>(exposure.gain_1e3) / 1'000, is_usb, out, problem);
  const std::array<float, 2> colours = {static_cast<float>(exposure.red_1e3) / 1'000,
                                        static_cast<float>(exposure.blue_1e3) / 1'000};
  if (!is_usb && !add_control(camera, "ColourGains", lc::ControlValue(lc::Span<const float, 2>(colours)), out)) {
    problem += " ColourGains";
  }
  if (problem.empty()) return Unit{};
  return Error{ErrorKind::kBadInput, "camera " + camera.id() + " cannot be told" + problem +
                                         ": leave [exposure] out of board.toml, give it numbers that the camera has "
                                         "(one on USB takes white_kelvin for its colours), or use another camera"};
}

}  // namespace ruffini
