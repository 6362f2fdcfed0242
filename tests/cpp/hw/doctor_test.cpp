#include "hw/doctor.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// A folder that stands for / of a board on which everything is right.
class DoctorTest : public testing::Test {
 protected:
  DoctorTest() {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    root_ = fs::path(testing::TempDir()) / ("doctor_" + std::string(info->name()) + std::to_string(::getpid()));
    fs::remove_all(root_);
    for (const char* node : {"media0", "gpiochip0", "i2c-1", "ttyGS0"}) write("dev/" + std::string(node), "");
    write("sys/class/udc/fe980000.usb/state", "configured\n");
    write("sys/class/udc/fe980000.usb/function", "configfs-gadget.ruffini\n");
    write("sys/devices/system/clocksource/clocksource0/current_clocksource", "arch_sys_counter\n");
    write("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n");
    write("sys/devices/platform/soc/soc:firmware/get_throttled", "0x0\n");
    write("sys/class/thermal/thermal_zone0/temp", "48312\n");
    fs::create_directories(root_ / "var/lib/ruffini");
    request_ = {root_.string(), "/dev/ttyGS0", "/var/lib/ruffini"};
  }
  ~DoctorTest() override { fs::remove_all(root_); }

  void write(const std::string& name, const std::string& text) {
    fs::create_directories((root_ / name).parent_path());
    std::ofstream(root_ / name) << text;
  }
  Check check(const std::string& name) {
    const std::vector<Check> checks = examine(request_);
    const auto found = std::find_if(checks.begin(), checks.end(), [&](const Check& c) { return c.name == name; });
    return found == checks.end() ? Check{} : *found;
  }

  fs::path root_;
  DoctorRequest request_;
};

TEST_F(DoctorTest, AllIsWell) {
  const std::vector<Check> checks = examine(request_);
  EXPECT_EQ(checks.size(), 11U);
  EXPECT_FALSE(has_failed(checks)) << as_text(checks);
  for (const char* name :
       {"camera", "gpio", "i2c", "usb", "link", "store", "clock", "governor", "throttling", "heat"}) {
    EXPECT_EQ(check(name).state, CheckState::kOk) << name;
    EXPECT_EQ(check(name).remedy, "") << name;
  }
}

struct Fault {
  const char* name;
  const char* removed;  // a path
  const char* written;  // a file
  const char* text;
  CheckState state;
  const char* remedy;  // a part of it
};

TEST_F(DoctorTest, EachFaultIsFoundWithItsRemedy) {
  const CheckState failed = CheckState::kFailed;
  const CheckState warning = CheckState::kWarning;
  const char* const throttled = "sys/devices/platform/soc/soc:firmware/get_throttled";
  const Fault faults[] = {
      {"camera", "dev/media0", nullptr, "", failed, "camera_auto_detect"},
      {"gpio", "dev/gpiochip0", nullptr, "", failed, "GPIO"},
      {"i2c", "dev/i2c-1", nullptr, "", warning, "dtparam=i2c_arm=on"},
      {"usb", "sys/class/udc/fe980000.usb", nullptr, "", failed, "dtoverlay=dwc2"},
      {"usb", nullptr, "sys/class/udc/fe980000.usb/state", "not attached\n", warning, "cable"},
      {"link", "dev/ttyGS0", nullptr, "", failed, "systemctl start ruffini-gadget"},
      {"store", "var/lib/ruffini", nullptr, "", failed, "install -d"},
      {"clock", nullptr, "sys/devices/system/clocksource/clocksource0/current_clocksource", "jiffies\n", failed,
       "timer driver"},
      {"governor", nullptr, "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "powersave\n", warning,
       "echo performance"},
      {"throttling", nullptr, throttled, "0x50005\n", failed, "5 V"},
      {"throttling", nullptr, throttled, "50000\n", warning, "5 V"},
      {"throttling", nullptr, throttled, "0x40004\n", failed, "cool"},
      {"heat", nullptr, "sys/class/thermal/thermal_zone0/temp", "81000\n", failed, "cool"},
  };
  for (const Fault& fault : faults) {
    const fs::path kept = root_.string() + "_kept";
    fs::remove_all(kept);
    fs::copy(root_, kept, fs::copy_options::recursive);
    if (fault.removed != nullptr) fs::remove_all(root_ / fault.removed);
    if (fault.written != nullptr) write(fault.written, fault.text);
    const Check found = check(fault.name);
    EXPECT_EQ(found.state, fault.state) << fault.name << ": " << found.found;
    EXPECT_NE(found.remedy.find(fault.remedy), std::string::npos) << fault.name << ": " << found.remedy;
    fs::remove_all(root_);
    fs::rename(kept, root_);
  }
}

TEST_F(DoctorTest, WhatMayNotBeOpenedIsSaidWithItsGroup) {
  for (const char* node : {"media0", "gpiochip0", "i2c-1", "ttyGS0"}) {
    fs::permissions(root_ / "dev" / node, fs::perms::owner_all);
  }
  // Root may open everything: another user looks.
  const pid_t child = ::fork();
  if (child == 0) {
    if (::geteuid() == 0 && ::setuid(65534) != 0) ::_exit(9);
    if (::geteuid() != 65534) ::_exit(0);  // not root: these files are our own
    const bool is_right = check("camera").remedy.find("-aG video") != std::string::npos &&
                          check("gpio").remedy.find("-aG gpio") != std::string::npos &&
                          check("i2c").remedy.find("-aG i2c") != std::string::npos &&
                          check("link").remedy.find("-aG dialout") != std::string::npos;
    ::_exit(is_right ? 0 : 1);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
}

TEST(Doctor, TextAndJson) {
  const std::vector<Check> checks = {{"usb", CheckState::kOk, "dummy", ""},
                                     {"heat", CheckState::kFailed, "a \"hot\"\nboard", "cool it"}};
  EXPECT_EQ(as_text(checks), "ok  usb: dummy\nfailed  heat: a \"hot\"\nboard\n    cool it\n");
  EXPECT_EQ(
      as_json(checks),
      "{\"ok\": false, \"checks\": [{\"name\": \"usb\", \"state\": \"ok\", \"found\": \"dummy\", \"remedy\": \"\"}, "
      "{\"name\": \"heat\", \"state\": \"failed\", \"found\": \"a \\\"hot\\\" board\", \"remedy\": \"cool it\"}]}\n");
}

}  // namespace
}  // namespace ruffini
