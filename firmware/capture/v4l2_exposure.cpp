#include "capture/v4l2_exposure.h"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cstdlib>
#include <utility>

namespace ruffini {
namespace {

constexpr std::chrono::seconds kReadPeriod{1};

std::optional<int32_t> get(int fd, uint32_t id) {
  v4l2_control control{id, 0};
  if (::ioctl(fd, VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

bool set(int fd, uint32_t id, int32_t value) {
  v4l2_control control{id, value};
  return ::ioctl(fd, VIDIOC_S_CTRL, &control) == 0;
}

}  // namespace

std::string drift_of(const V4l2Exposure& said, const V4l2Exposure& first, const ExposureSettings& asked) {
  if (said.mode && *said.mode != V4L2_EXPOSURE_MANUAL && *said.mode != V4L2_EXPOSURE_SHUTTER_PRIORITY) {
    return "its automatic exposure on, asked off";
  }
  // Its unit is 100 us; a camera's steps may be wider.
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
                                              " does not open, by which it is told exposure.white_kelvin: is this user "
                                              "in the group video?"};
  }
  v4l2_queryctrl about{};
  about.id = V4L2_CID_WHITE_BALANCE_TEMPERATURE;
  const std::string cannot = "camera " + camera + " cannot be told exposure.white_kelvin";
  if (::ioctl(fd.get(), VIDIOC_QUERYCTRL, &about) != 0) {
    return Error{ErrorKind::kBadInput, cannot + ": leave [exposure] out of board.toml, or use another camera"};
  }
  const auto kelvin = static_cast<int32_t>(asked.white_kelvin);
  if (kelvin < about.minimum || kelvin > about.maximum) {
    return Error{ErrorKind::kBadInput, cannot + " = " + std::to_string(kelvin) + ", only " +
                                           std::to_string(about.minimum) + " to " + std::to_string(about.maximum)};
  }
  // A camera that has no automatic has nothing to be switched off.
  if ((get(fd.get(), V4L2_CID_AUTO_WHITE_BALANCE).value_or(0) != 0 && !set(fd.get(), V4L2_CID_AUTO_WHITE_BALANCE, 0)) ||
      !set(fd.get(), V4L2_CID_WHITE_BALANCE_TEMPERATURE, kelvin)) {
    return Error{ErrorKind::kBadInput, cannot + ": it refuses. dmesg says more"};
  }
  return V4l2Controls(std::move(fd), asked);
}

const std::string& V4l2Controls::drift() {
  const auto now = std::chrono::steady_clock::now();
  if (now >= due_) {
    due_ = now + kReadPeriod;
    const V4l2Exposure said = read();
    if (!first_) first_ = said;
    drift_ = drift_of(said, *first_, asked_);
  }
  return drift_;
}

V4l2Exposure V4l2Controls::read() const {
  const int fd = fd_.get();
  return {.mode = get(fd, V4L2_CID_EXPOSURE_AUTO),
          .time_100us = get(fd, V4L2_CID_EXPOSURE_ABSOLUTE),
          .gain = get(fd, V4L2_CID_GAIN),
          .is_white_auto = get(fd, V4L2_CID_AUTO_WHITE_BALANCE),
          .white_kelvin = get(fd, V4L2_CID_WHITE_BALANCE_TEMPERATURE)};
}

}  // namespace ruffini
