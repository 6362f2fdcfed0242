#include "hw/doctor.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include "hw/json_text.h"
#include "hw/led_driver.h"
#include "hw/thread_place.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kHotMilliCelsius = 80'000;        // a Raspberry Pi throttles from here on
constexpr rlim_t kLockedBytes = rlim_t{256} << 20;  // buffers, calibration and code of the daemon

std::optional<std::string> first_line(const fs::path& path) {
  std::ifstream stream(path);
  std::string line;
  if (!std::getline(stream, line)) return std::nullopt;
  return line;
}

std::optional<int64_t> number(const fs::path& path, int base) {
  const std::optional<std::string> line = first_line(path);
  if (!line) return std::nullopt;
  const char* first = line->data() + (base == 16 && line->rfind("0x", 0) == 0 ? 2 : 0);
  int64_t value = 0;
  const auto [rest, problem] = std::from_chars(first, line->data() + line->size(), value, base);
  return problem == std::errc() ? std::optional(value) : std::nullopt;
}

// Entries of a folder whose names begin with `prefix`, sorted.
std::vector<fs::path> entries(const fs::path& folder, const std::string& prefix) {
  std::vector<fs::path> found;
  std::error_code failed;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, failed)) {
    if (entry.path().filename().string().rfind(prefix, 0) == 0) found.push_back(entry.path());
  }
  std::sort(found.begin(), found.end());
  return found;
}

std::string names(const std::vector<fs::path>& paths) {
  std::string list;
  for (const fs::path& path : paths) list += (list.empty() ? "" : ", ") + path.filename().string();
  return list;
}

// True if the calling user may read and write: by effective user, as open() checks it.
bool may_use(const fs::path& path) { return ::faccessat(AT_FDCWD, path.c_str(), R_OK | W_OK, AT_EACCESS) == 0; }

class Examination {
 public:
  explicit Examination(const DoctorRequest& request) : request_(request) {}

  std::vector<Check> all() {
    nodes("camera", "media", CheckState::kFailed,
          "no /dev/media*: is the camera's cable in, the right way round, and camera_auto_detect=1 (or its dtoverlay) "
          "in /boot/firmware/config.txt?",
          "video");
    nodes("gpio", "gpiochip", CheckState::kFailed, "no /dev/gpiochip*: the kernel has no GPIO driver for this board",
          "gpio");
    nodes("i2c", "i2c-", CheckState::kWarning,
          "no /dev/i2c-*: dtparam=i2c_arm=on in /boot/firmware/config.txt and modprobe i2c-dev, then reboot", "i2c");
    usb_port();
    link();
    store();
    clock();
    governor();
    throttling();
    heat();
    memory_lock();
    return std::move(checks_);
  }

 private:
  [[nodiscard]] fs::path at(const std::string& path) const { return request_.root + path; }
  void add(const char* name, CheckState state, std::string found, std::string remedy = {}) {
    checks_.push_back({name, state, std::move(found), std::move(remedy)});
  }

  void nodes(const char* name, const std::string& prefix, CheckState where_missing, const std::string& missing,
             const std::string& group) {
    const std::vector<fs::path> found = entries(at("/dev"), prefix);
    const auto locked = std::find_if(found.begin(), found.end(), [](const fs::path& path) { return !may_use(path); });
    if (found.empty()) return add(name, where_missing, "none", missing);
    if (locked != found.end()) {
      return add(name, CheckState::kFailed, locked->string() + " may not be opened",
                 "add the user to the group " + group + " (sudo usermod -aG " + group + " USER) and log in again");
    }
    add(name, CheckState::kOk, names(found));
  }

  void usb_port() {
    const std::vector<fs::path> found = entries(at("/sys/class/udc"), "");
    if (found.empty()) {
      return add("usb", CheckState::kFailed, "no USB port in device mode",
                 "dtoverlay=dwc2,dr_mode=peripheral in /boot/firmware/config.txt, then reboot");
    }
    const std::string state = first_line(found.front() / "state").value_or("unknown");
    if (state == "configured") return add("usb", CheckState::kOk, names(found) + ", configured by a host");
    const bool is_bound = !first_line(found.front() / "function").value_or("").empty();
    add("usb", CheckState::kWarning, names(found) + ", " + state,
        is_bound ? "plug the cable into a host: one that carries data, at the port in device mode"
                 : "start the gadget: sudo systemctl start ruffini-gadget");
  }

  void link() {
    if (request_.link.rfind("pty", 0) == 0) return add("link", CheckState::kOk, request_.link);
    const fs::path path = at(request_.link);
    std::error_code failed;
    if (!fs::exists(path, failed)) {
      return add("link", CheckState::kFailed, request_.link + " is missing",
                 "start the gadget: sudo systemctl start ruffini-gadget");
    }
    if (!may_use(path)) {
      return add("link", CheckState::kFailed, request_.link + " may not be opened",
                 "add the user to the group dialout (sudo usermod -aG dialout USER) and log in again");
    }
    add("link", CheckState::kOk, request_.link);
  }

  void store() {
    const fs::path path = at(request_.store);
    std::error_code failed;
    if (!fs::is_directory(path, failed)) {
      return add("store", CheckState::kFailed, request_.store + " is no folder",
                 "make it: sudo install -d -o ruffini -m 700 " + request_.store);
    }
    if (!may_use(path)) {
      return add("store", CheckState::kFailed, request_.store + " may not be written",
                 "chown ruffini it, or mount its file system for writing: calibrations could not be flashed");
    }
    add("store", CheckState::kOk, request_.store);
  }

  void clock() {
    const auto source = first_line(at("/sys/devices/system/clocksource/clocksource0/current_clocksource"));
    if (!source) return add("clock", CheckState::kWarning, "unknown", "mount /sys");
    if (*source == "jiffies" || *source == "refined-jiffies") {
      return add("clock", CheckState::kFailed, *source + ": stamps would be off by up to 10 ms",
                 "boot a kernel with this computer's timer driver");
    }
    add("clock", CheckState::kOk, *source);
  }

  void governor() {
    std::string slow;
    bool has_any = false;
    for (const fs::path& cpu : entries(at("/sys/devices/system/cpu"), "cpu")) {
      const auto governor = first_line(cpu / "cpufreq/scaling_governor");
      has_any = has_any || governor;
      if (governor && *governor != "performance") slow = cpu.filename().string() + " " + *governor;
    }
    if (!slow.empty()) {
      return add("governor", CheckState::kWarning, slow + ": frames wait while the clock rises",
                 "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor");
    }
    add("governor", CheckState::kOk, has_any ? "performance" : "fixed clock");
  }

  // Bits of the Raspberry Pi's firmware: 0 to 3 now, 16 to 19 since boot; under-voltage, capped, throttled, soft limit.
  void throttling() {
    const auto bits = number(at("/sys/devices/platform/soc/soc:firmware/get_throttled"), 16);
    if (!bits) return add("throttling", CheckState::kOk, "not told by this computer");
    if (*bits == 0) return add("throttling", CheckState::kOk, "none");
    const int64_t now = *bits & 0xF;
    const bool is_voltage = ((*bits | *bits >> 16) & 1) != 0;
    add("throttling", now != 0 ? CheckState::kFailed : CheckState::kWarning,
        std::string(is_voltage ? "under-voltage" : "slowed down by heat") + (now != 0 ? " now" : " since boot"),
        is_voltage ? "use a power supply and a cable that hold 5 V under load" : "cool the computer");
  }

  void heat() {
    int64_t hottest = INT64_MIN;
    for (const fs::path& zone : entries(at("/sys/class/thermal"), "thermal_zone")) {
      hottest = std::max(hottest, number(zone / "temp", 10).value_or(INT64_MIN));
    }
    if (hottest == INT64_MIN) return add("heat", CheckState::kOk, "not told by this computer");
    const std::string found = std::to_string(hottest / 1'000) + " C";
    if (hottest >= kHotMilliCelsius) return add("heat", CheckState::kFailed, found, "cool the computer");
    add("heat", CheckState::kOk, found);
  }

  void memory_lock() {
    rlimit limit{};
    ::getrlimit(RLIMIT_MEMLOCK, &limit);
    if (limit.rlim_cur != RLIM_INFINITY && limit.rlim_cur < kLockedBytes) {
      return add("memory lock", CheckState::kWarning, "at most " + std::to_string(limit.rlim_cur >> 10) + " KiB",
                 "start it by its service (LimitMEMLOCK=infinity), or ulimit -l unlimited");
    }
    add("memory lock", CheckState::kOk, "allowed");
  }

  const DoctorRequest& request_;
  std::vector<Check> checks_;
};

const char* word(CheckState state) {
  switch (state) {
    case CheckState::kOk:
      return "ok";
    case CheckState::kWarning:
      return "warning";
    case CheckState::kFailed:
      return "failed";
  }
  return "";
}

}  // namespace

std::vector<Check> examine(const DoctorRequest& request) { return Examination(request).all(); }

Check examine_threads(const ThreadsSettings& threads) {
  std::string found;
  std::string problems;
  for (const char* role : {"capture", "frame", "link", "inference"}) {
    const ThreadSettings& wanted = thread_of(threads, role);
    if (wanted.priority == 0 && wanted.cpus == 0) continue;
    std::thread([&] {
      const std::string problem = place_thread(role, wanted);
      found += (found.empty() ? "" : ", ") + std::string(role) + " " + thread_placement();
      if (!problem.empty()) problems += (problems.empty() ? "" : "; ") + problem;
    }).join();
  }
  if (found.empty()) return {"threads", CheckState::kOk, "as the daemon is started, all alike", ""};
  return {"threads", problems.empty() ? CheckState::kOk : CheckState::kWarning, found, problems};
}

Check examine_lamps(const LedDriverSettings& driver, I2cBus* bus) {
  if (driver.bus.empty()) return {"lamps", CheckState::kOk, "without a driver on I2C", ""};
  std::unique_ptr<I2cBus> own;
  if (bus == nullptr) {
    auto opened = open_i2c(driver.bus);
    if (!opened) return {"lamps", CheckState::kFailed, opened.error().message, ""};
    own = std::move(opened).value();
    bus = own.get();
  }
  if (const Status found = LedDriver::find(*bus, driver.address); !found) {
    return {"lamps", CheckState::kFailed, "their driver: " + found.error().message, ""};
  }
  return {"lamps", CheckState::kOk, "their driver answers on " + bus->name(), ""};
}

bool has_failed(const std::vector<Check>& checks) {
  return std::any_of(checks.begin(), checks.end(), [](const Check& c) { return c.state == CheckState::kFailed; });
}

std::string as_text(const std::vector<Check>& checks) {
  std::string text;
  for (const Check& check : checks) {
    text += std::string(word(check.state)) + "  " + check.name + ": " + check.found + "\n";
    if (!check.remedy.empty()) text += "    " + check.remedy + "\n";
  }
  return text;
}

std::string as_json(const std::vector<Check>& checks) {
  std::string text = std::string("{\"ok\": ") + (has_failed(checks) ? "false" : "true") + ", \"checks\": [";
  for (size_t i = 0; i < checks.size(); ++i) {
    const Check& check = checks[i];
    text += std::string(i == 0 ? "" : ", ") + "{\"name\": " + json_quoted(check.name) + ", \"state\": \"" +
            word(check.state) + "\", \"found\": " + json_quoted(check.found) +
            ", \"remedy\": " + json_quoted(check.remedy) + "}";
  }
  return text + "]}\n";
}

}  // namespace ruffini
