#include "capture/v4l2_exposure.h"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <utility>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

constexpr std::chrono::seconds kReadPeriod{1};

using Ioctl = V4l2Controls::Ioctl;

std::optional<int32_t> get(const Ioctl& device, uint32_t id) {
  v4l2_control control{id, 0};
  if (device(VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

bool set_control(const Ioctl& device, uint32_t id, int32_t value) {
  v4l2_control control{id, value};
  return device(VIDIOC_S_CTRL, &control) == 0;
}

std::optional<v4l2_queryctrl> limits_of(const Ioctl& device, uint32_t id) {
  v4l2_queryctrl about{};
  about.id = id;
  if (device(VIDIOC_QUERYCTRL, &about) != 0 || (about.flags & V4L2_CTRL_FLAG_DISABLED) != 0) return std::nullopt;
  return about;
}

std::string only(int64_t asked, int64_t minimum, int64_t maximum) {
  return " = " + std::to_string(asked) + ", only " + std::to_string(minimum) + " to " + std::to_string(maximum);
}

// A camera without an automatic has nothing to switch off.
bool switch_off(const Ioctl& device, uint32_t automatic) {
  return get(device, automatic).value_or(0) == 0 || set_control(device, automatic, 0);
}

// Each function sets its part of [exposure] and returns what the device does not support; empty on success.

std::string set_time(const Ioctl& device, const ExposureSettings& asked) {
  constexpr int64_t kUnitUs = 100;
  const auto limits = limits_of(device, V4L2_CID_EXPOSURE_ABSOLUTE);
  if (!limits) return "exposure.time_us";
  const auto time = static_cast<int32_t>((asked.time_us + kUnitUs / 2) / kUnitUs);
  if (time < limits->minimum || time > limits->maximum) {
    return "exposure.time_us" + only(asked.time_us, kUnitUs * limits->minimum, kUnitUs * limits->maximum);
  }
  const bool is_manual = !get(device, V4L2_CID_EXPOSURE_AUTO) ||
                         set_control(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL) ||
                         set_control(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_SHUTTER_PRIORITY);
  // With this control on, a camera lowers its frame rate in the dark.
  const bool keeps_rate = switch_off(device, V4L2_CID_EXPOSURE_AUTO_PRIORITY);
  return is_manual && keeps_rate && set_control(device, V4L2_CID_EXPOSURE_ABSOLUTE, time) ? "" : "exposure.time_us";
}

std::string set_gain(const Ioctl& device, const ExposureSettings& asked, std::optional<int32_t>& gain) {
  const auto limits = limits_of(device, V4L2_CID_GAIN);
  if (!limits) return "exposure.gain_1e3";
  gain = device_gain(asked.gain_1e3, limits->minimum, limits->maximum, limits->default_value);
  if (!gain) {
    return "exposure.gain_1e3 = " + std::to_string(asked.gain_1e3) + ", only its own " +
           std::to_string(limits->minimum) + " to " + std::to_string(limits->maximum) + ", 1000 being " +
           std::to_string(limits->default_value);
  }
  return switch_off(device, V4L2_CID_AUTOGAIN) && set_control(device, V4L2_CID_GAIN, *gain) ? "" : "exposure.gain_1e3";
}

std::string set_white(const Ioctl& device, const ExposureSettings& asked) {
  const auto limits = limits_of(device, V4L2_CID_WHITE_BALANCE_TEMPERATURE);
  if (!limits) return "exposure.white_kelvin";
  const auto kelvin = static_cast<int32_t>(asked.white_kelvin);
  if (kelvin < limits->minimum || kelvin > limits->maximum) {
    return "exposure.white_kelvin" + only(kelvin, limits->minimum, limits->maximum);
  }
  const bool is_set = switch_off(device, V4L2_CID_AUTO_WHITE_BALANCE) &&
                      set_control(device, V4L2_CID_WHITE_BALANCE_TEMPERATURE, kelvin);
  return is_set ? "" : "exposure.white_kelvin";
}

Error cannot_be_told(const std::string& camera, const std::string& what) {
  return {ErrorKind::kBadInput,
          "camera " + camera + " cannot be told " + what +
              ": give [exposure] of board.toml numbers that the camera has, or leave that section out"};
}

}  // namespace

std::string drift_of(const V4l2Exposure& said, const V4l2Exposure& first, const ExposureSettings& asked) {
  if (said.mode && *said.mode != V4L2_EXPOSURE_MANUAL && *said.mode != V4L2_EXPOSURE_SHUTTER_PRIORITY) {
    return "its automatic exposure on, asked off";
  }
  // Its unit is 100 us; a camera's steps may be larger.
  const int64_t step_us = std::max<int64_t>(100, asked.time_us / 50);
  if (said.time_100us && std::abs(100 * int64_t{*said.time_100us} - asked.time_us) > step_us) {
    return "an exposure of " + std::to_string(100 * int64_t{*said.time_100us}) + " us, asked " +
           std::to_string(asked.time_us);
  }
  if (said.gain && first.gain && *said.gain != *first.gain) {
    return "a gain of " + std::to_string(*said.gain) + " in its own unit, " + std::to_string(*first.gain) +
           " at the start";
  }
  if (said.is_white_auto.value_or(0) != 0) return "its automatic white balance on, asked off";
  if (said.white_kelvin && std::abs(*said.white_kelvin - asked.white_kelvin) * 50 > asked.white_kelvin) {
    return "a white of " + std::to_string(*said.white_kelvin) + " K, asked " + std::to_string(asked.white_kelvin);
  }
  return {};
}

Result<V4l2Controls> V4l2Controls::open(const std::string& camera, const std::string& path,
                                        const ExposureSettings& asked) {
  UniqueFd fd(::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK));
  if (!fd) {
    return Error{ErrorKind::kUnavailable, "camera " + camera + ": " + path +
                                              " cannot be opened to set exposure.white_kelvin: is this user in the "
                                              "group video?"};
  }
  const auto kept = std::make_shared<UniqueFd>(std::move(fd));
  const Ioctl device = [kept](unsigned long request, void* argument) {
    return ::ioctl(kept->get(), request, argument);
  };
  if (const std::string problem = set_white(device, asked); !problem.empty()) return cannot_be_told(camera, problem);
  return V4l2Controls(device, asked);
}

Result<V4l2Controls> V4l2Controls::set(const std::string& camera, Ioctl device, const ExposureSettings& asked) {
  if (asked.white_kelvin == 0) {
    return Error{ErrorKind::kBadInput, "camera " + camera +
                                           " has no gains of single colours: give white_kelvin in "
                                           "[exposure] of board.toml instead of red_1e3 and blue_1e3"};
  }
  std::optional<int32_t> gain;
  std::string problem;
  for (const std::string& part : {set_time(device, asked), set_gain(device, asked, gain), set_white(device, asked)}) {
    problem += (problem.empty() || part.empty() ? "" : "; ") + part;
  }
  if (!problem.empty()) return cannot_be_told(camera, problem);
  V4l2Controls controls(std::move(device), asked);
  controls.first_ = V4l2Exposure{.mode = {}, .time_100us = {}, .gain = gain, .is_white_auto = {}, .white_kelvin = {}};
  return controls;
}

std::optional<int32_t> device_gain(int64_t gain_1e3, int32_t minimum, int32_t maximum, int32_t otherwise) {
  const int64_t above = int64_t{maximum} - otherwise;
  const int64_t below = int64_t{otherwise} - minimum;
  int64_t numerator = 3'000;  // thousandths of gain for `denominator` steps
  int64_t denominator = above;
  if (above <= 0 || numerator * below > 500 * above) {
    numerator = 500;
    denominator = below;
  }
  if (denominator <= 0) return gain_1e3 == 1'000 ? std::optional(otherwise) : std::nullopt;
  const int64_t away = (gain_1e3 - 1'000) * denominator;
  const int64_t steps = (2 * away + (away < 0 ? -numerator : numerator)) / (2 * numerator);
  const int64_t value = otherwise + steps;
  if (value < minimum || value > maximum) return std::nullopt;
  return static_cast<int32_t>(value);
}

const std::string& V4l2Controls::drift(std::chrono::steady_clock::time_point now) {
  if (now >= due_) {
    due_ = now + kReadPeriod;
    const V4l2Exposure said = read();
    if (!first_) first_ = said;
    drift_ = drift_of(said, *first_, asked_);
  }
  return drift_;
}

V4l2Exposure V4l2Controls::read() const {
  return {.mode = get(device_, V4L2_CID_EXPOSURE_AUTO),
          .time_100us = get(device_, V4L2_CID_EXPOSURE_ABSOLUTE),
          .gain = get(device_, V4L2_CID_GAIN),
          .is_white_auto = get(device_, V4L2_CID_AUTO_WHITE_BALANCE),
          .white_kelvin = get(device_, V4L2_CID_WHITE_BALANCE_TEMPERATURE)};
}

}  // namespace ruffini
