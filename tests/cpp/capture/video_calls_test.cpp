// What sysfs says of cameras, from a folder like it.
#include "capture/video_calls.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <cerrno>
#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

namespace fs = std::filesystem;

class VideoNodes : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "ruffini-sysfs-XXXXXX").string();
    root_ = ::mkdtemp(pattern.data());
    fs::create_directory(root_ / "class");
  }
  void TearDown() override { fs::remove_all(root_); }

  void add(const std::string& node, const std::string& name, const fs::path& device) {
    fs::create_directories(root_ / "class" / node);
    fs::create_directories(root_ / device);
    write("class/" + node + "/name", name);
    fs::create_directory_symlink(root_ / device, root_ / "class" / node / "device");
  }
  void write(const std::string& file, const std::string& line) { std::ofstream(root_ / file) << line << "\n"; }

  fs::path root_;
};

TEST_F(VideoNodes, NamesIdentitiesAndOrder) {
  add("video10", "On a board", "platform/isp");
  add("video2", "GelSight Mini R0B", "usb/1-2/1-2:1.0");
  add("v4l-subdev0", "A sensor", "platform/sensor");
  write("usb/1-2/idVendor", "1d6b");
  write("usb/1-2/idProduct", "0102");
  write("usb/1-2/serial", "28A1-T0FG");
  const auto nodes = VideoCalls::of_kernel((root_ / "class").string()).nodes();
  ASSERT_EQ(nodes.size(), 2U);
  EXPECT_EQ(nodes[0].path, "/dev/video2");
  EXPECT_EQ(nodes[0].name, "GelSight Mini R0B");
  EXPECT_EQ(nodes[0].serial, "28A1-T0FG");
  EXPECT_EQ(nodes[0].vendor, 0x1d6b);
  EXPECT_EQ(nodes[0].product, 0x102);
  EXPECT_EQ(nodes[1].path, "/dev/video10");
  EXPECT_EQ(nodes[1].vendor, 0);
  EXPECT_TRUE(VideoCalls::of_kernel((root_ / "none").string()).nodes().empty());
}

TEST_F(VideoNodes, CallsReportErrno) {
  const VideoCalls calls = VideoCalls::of_kernel();
  EXPECT_EQ(calls.open((root_ / "video0").string()), -1);
  EXPECT_EQ(errno, ENOENT);
  const int fd = calls.open("/dev/null");
  ASSERT_GE(fd, 0);
  int type = 0;
  EXPECT_EQ(calls.ioctl(fd, 0x40045612, &type), -1);
  EXPECT_EQ(errno, ENOTTY);
  EXPECT_EQ(calls.map(fd, 4'096, 0), nullptr);
  EXPECT_EQ(calls.close(fd), 0);
}

}  // namespace
}  // namespace ruffini
