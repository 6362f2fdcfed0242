#include "hw/led_driver.h"

#include <algorithm>
#include <span>
#include <utility>

namespace ruffini {
namespace {

constexpr uint8_t kMode1 = 0x00;
constexpr uint8_t kMode2 = 0x01;
constexpr uint8_t kLedOut0 = 0x02;
constexpr uint8_t kIref0 = 0x18;
constexpr uint8_t kEFlag0 = 0x46;
constexpr uint8_t kIncrement = 0x80;
constexpr uint8_t kHot = 0x80;
constexpr uint8_t kFaulty = 0x40;
constexpr uint8_t kClear = 0x10;  // bit of MODE2: clears the fault flags
constexpr size_t kPerByte = 4;    // outputs per byte of LEDOUT and EFLAG
constexpr int64_t kStepUv = 225'000;
constexpr int kRampSteps = 32;

using LedOut = std::array<uint8_t, LedDriver::kOutputs / kPerByte>;

}  // namespace

LedDriver::LedDriver(std::unique_ptr<I2cBus> bus, const LedDriverSettings& settings)
    : bus_(std::move(bus)), address_(static_cast<uint8_t>(settings.address)), settings_(settings) {}

LedDriver::~LedDriver() { static_cast<void>(off()); }

Result<std::unique_ptr<LedDriver>> LedDriver::open(std::unique_ptr<I2cBus> bus, const LedDriverSettings& settings,
                                                   const Sleep& sleep) {
  std::unique_ptr<LedDriver> driver(new LedDriver(std::move(bus), settings));
  for (size_t i = 0; i < std::min(settings.currents_ua.size(), kOutputs); ++i) {
    const int64_t step = (settings.currents_ua[i] * settings.resistor_ohm + kStepUv / 2) / kStepUv;
    if (step > UINT8_MAX) {
      return Error{ErrorKind::kBadInput, "led_driver.currents_ua: " + std::to_string(settings.currents_ua[i]) +
                                             " uA is more than " + std::to_string(settings.resistor_ohm) +
                                             " Ohm allow (" +
                                             std::to_string(UINT8_MAX * kStepUv / settings.resistor_ohm) +
                                             " uA): correct it, or solder a smaller resistor"};
    }
    driver->steps_[i] = static_cast<uint8_t>(step);
    uint8_t& lit = driver->lit_[i / kPerByte];
    if (step != 0) lit = static_cast<uint8_t>(lit | 1U << 2 * (i % kPerByte));
  }
  if (Status lit = driver->light(sleep); !lit) return lit.error();
  return driver;
}

Status LedDriver::find(I2cBus& bus, int64_t address) {
  std::array<uint8_t, 1> mode{};
  return exchange(bus, static_cast<uint8_t>(address), std::array{kMode1}, mode);
}

Status LedDriver::light(const Sleep& sleep) {
  if (Status dark = off(); !dark) return dark;
  if (Status awake = write(kMode1, std::array<uint8_t, 1>{0}); !awake) return awake;
  if (Status cleared = write(kMode2, std::array<uint8_t, 1>{kClear}); !cleared) return cleared;
  const int n = settings_.ramp_ms > 0 ? kRampSteps : 1;
  for (int k = 1; k <= n; ++k) {
    std::array<uint8_t, kOutputs> now{};
    std::transform(steps_.begin(), steps_.end(), now.begin(),
                   [&](uint8_t s) { return static_cast<uint8_t>(s * k / n); });
    if (Status set = write(kIref0, now); !set) return set;
    if (k == 1) {
      if (Status set = write(kLedOut0, lit_); !set) return set;
    }
    if (k < n) sleep(std::chrono::milliseconds(settings_.ramp_ms / kRampSteps));
  }
  const Result<bool> kept = is_as_set();
  if (!kept) return kept.error();
  if (kept.value()) return Unit{};
  return Error{ErrorKind::kUnavailable, bus_->name() +
                                            ": what answers at led_driver.address does not keep its currents: "
                                            "is it a PCA9955B?"};
}

Result<bool> LedDriver::is_as_set() {
  std::array<uint8_t, kOutputs> steps{};
  if (Status told = read(kIref0, steps); !told) return told.error();
  LedOut lit{};
  if (Status told = read(kLedOut0, lit); !told) return told.error();
  return steps == steps_ && lit == lit_;
}

std::string LedDriver::check(std::optional<int32_t> milli_celsius) {
  if (!out_.empty()) return out_;
  std::array<uint8_t, 1> mode{};
  if (Status told = read(kMode2, mode); !told) return "the lamps' driver: " + told.error().message;
  const bool has_limit = settings_.max_milli_celsius != INT32_MAX;
  const bool is_warm = has_limit && milli_celsius && *milli_celsius > settings_.max_milli_celsius;
  if ((mode[0] & kHot) != 0 || is_warm) {
    out_ = is_warm ? "the lamps were put out: " + std::to_string(*milli_celsius) +
                         " thousandths of a degree are more than " + "led_driver.max_milli_celsius"
                   : std::string("the lamps were put out: their driver is too hot");
    out_ += ": cool it and start ruffinid again";
    if (Status dark = off(); !dark) out_ += "; " + dark.error().message;
    return out_;
  }
  const Result<bool> kept = is_as_set();
  if (!kept) return "the lamps' driver: " + kept.error().message;
  if (!kept.value()) return "the lamps' driver forgot its currents: did its supply fail? Start ruffinid again";
  if ((mode[0] & kFaulty) != 0) return faults_of_outputs();
  if (has_limit && !milli_celsius) return "led_driver.max_milli_celsius: the thermometer of [temperature] says nothing";
  return {};
}

// Only for outputs in use: nothing is connected to the others.
std::string LedDriver::faults_of_outputs() {
  LedOut flags{};
  if (Status told = read(kEFlag0, flags); !told) return "the lamps' driver: " + told.error().message;
  std::string list;
  for (size_t i = 0; i < kOutputs; ++i) {
    const int fault = flags[i / kPerByte] >> 2 * (i % kPerByte) & 3;
    if (steps_[i] == 0 || fault == 0) continue;
    list += (list.empty() ? "" : ", ") + std::to_string(i) + (fault == 1 ? " shorted" : " open");
  }
  // So that a fault that has ended is not reported again
  static_cast<void>(write(kMode2, std::array<uint8_t, 1>{kClear}));
  return list.empty() ? std::string() : "lamps at the driver's outputs: " + list;
}

Status LedDriver::off() { return write(kLedOut0, LedOut{}); }

Status LedDriver::write(uint8_t first, std::span<const uint8_t> values) {
  std::array<uint8_t, 1 + kOutputs> out{static_cast<uint8_t>(first | kIncrement)};
  std::copy(values.begin(), values.end(), out.begin() + 1);
  return exchange(*bus_, address_, std::span(out).first(1 + values.size()), {});
}

Status LedDriver::read(uint8_t first, std::span<uint8_t> values) {
  return exchange(*bus_, address_, std::array{static_cast<uint8_t>(first | kIncrement)}, values);
}

}  // namespace ruffini
