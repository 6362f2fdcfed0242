// [pipeline] cores = 2 gives the bits of one core: segment by segment, and with the daemon's two frame threads over a
// real pty.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <numeric>
#include <thread>
#include <utility>
#include <vector>

#include "daemon.h"
#include "hw/system.h"
#include "hw/thermometer.h"
#include "link/serial_port.h"
#include "support/scenes.h"

namespace ruffini {
namespace {

constexpr uint64_t kFrameUs = 16'667;

uint64_t no_clock() { return 0; }

test::Scene on_cores(test::Scene scene, int n_cores) {
  scene.board.n_cores = n_cores;
  return scene;
}

std::unique_ptr<FramePath> path_of(const test::Scene& scene) {
  auto path = FramePath::configure(scene.board, CalibrationFile::load(scene.calibration).value(), no_clock);
  EXPECT_TRUE(path) << (path ? "" : path.error().message);
  return std::move(path).value();
}

// The slots' numbers, one after the other. `has_difference`: it is handed over to a later stage.
std::vector<int64_t> numbers_of(const FrameState& s, bool has_difference) {
  std::vector<int64_t> out{s.flags, static_cast<int64_t>(s.saturations.count)};
  const auto put = [&](auto... values) { (out.push_back(static_cast<int64_t>(values)), ...); };
  const auto put_all = [&](const auto& values) {
    for (const auto& v : values) put(v);
  };
  if (has_difference) {
    for (const auto& v : s.difference.change) put(v.raw());
    put_all(s.difference.grey);
    put(s.difference.exposure.dark, s.difference.exposure.full);
  }
  put(s.light.is_drifting);
  put_all(s.light.gain);
  put_all(s.light.level);
  const auto put_markers = [&](const std::vector<Marker>& markers) {
    for (const Marker& m : markers) {
      put(m.rest_x.raw(), m.rest_y.raw(), m.displacement_x.raw(), m.displacement_y.raw(), m.is_lost);
    }
  };
  put_markers(s.markers.marker);
  put(s.markers.n_lost, s.markers.n_at_rest, s.targets.n_lost);
  put_markers(s.targets.mark);
  put_all(s.features.value);
  for (const CellSlope& v : s.photometric.slope) put(v.x.raw(), v.y.raw());
  for (const auto& v : s.depth.cell) put(v.raw());
  put(s.depth.validity, s.depth.is_trusted, s.depth.sigma_um);
  for (const NodeDisplacement& u : s.displacement.node) put(u.x.raw(), u.y.raw(), u.z.raw());
  put_all(s.displacement.filled);
  put(s.displacement.has_depth, s.displacement.zero_moved_nm, s.displacement.is_zero_at_limit);
  put_all(s.solve.u);
  for (const NodeForce& f : s.solve.force) put(f.x, f.y, f.z);
  put_all(s.solve.mask);
  put(s.solve.threshold_lsb, s.solve.is_light_steady, s.solve.is_refined, s.solve.is_explained, s.force.xy, s.force.z);
  const Wrench& w = s.wrench.sum;
  put(w.force_x_un, w.force_y_un, w.force_z_un, w.torque_x_un_um, w.torque_y_un_um, w.torque_z_un_um);
  put_all(s.wrench.validity);
  put_all(s.covariance.wrench.upper);
  put(s.covariance.is_stated, s.covariance.validity, s.contacts.n_found, s.contacts.n_listed);
  for (const Contact& c : s.contacts.contacts) put(c.area_um2, c.center_x_um, c.force_x_un, c.force_z_un);
  put_all(s.slip.node);
  put(s.modelled.gel_depth_um, s.modelled.area_um2, s.vibration.level_cdb, s.vibration.validity);
  return out;
}

// Frames of two units that differ in their cores alone. Brightness rises by a level in each of the first frames.
void expect_same(const test::Scene& scene, bool is_live) {
  const auto one = path_of(on_cores(scene, 1));
  const auto two = path_of(on_cores(scene, 2));
  ASSERT_EQ(one->n_segments(), 1U);
  ASSERT_GT(two->n_segments(), 1U);
  one->set_live(is_live);
  two->set_live(is_live);
  bool was_touched = false;
  bool had_depth = false;
  for (int i = 0; i < 60; ++i) {
    std::vector<uint8_t> pixels = i >= 8 && i / 4 % 2 == 0 ? scene.pressed : scene.rest;
    for (size_t k = static_cast<size_t>(i); k < pixels.size(); k += 7) pixels[k] ^= 1;  // no frame is as another
    if (i == 24) {
      for (uint8_t& value : pixels) value = static_cast<uint8_t>(value / 8);  // dark
    }
    for (FramePath* path : {one.get(), two.get()}) {
      if (i == 30) path->zero(3, false);
      if (i == 50) path->zero(9);
      if (i == 52) path->cancel_zero();
      const BoardSettings& board = path->board();
      path->process(
          {pixels.data(), board.camera.width_px, board.camera.height_px, 3, ptrdiff_t{3} * board.camera.width_px},
          kFrameUs * static_cast<uint64_t>(i + 1));
      if (i % 5 == 0) path->compute_residual();
    }
    was_touched = was_touched || one->is_touched();
    had_depth = had_depth || one->state().depth.validity == Validity::kValid;
    const bool has_difference = one->writes(Slot::kVibration);
    ASSERT_EQ(numbers_of(one->state(), has_difference), numbers_of(two->state(), has_difference)) << "frame " << i;
    ASSERT_EQ(one->state().residual.node, two->state().residual.node) << "frame " << i;
    ASSERT_EQ(one->is_touched(), two->is_touched());
  }
  EXPECT_TRUE(one->writes(Slot::kContacts) ? was_touched : had_depth);
}

TEST(TwoCores, SegmentsGiveTheBitsOfOne) { expect_same(test::dots(), false); }
TEST(TwoCores, SegmentsGiveTheBitsOfOneForALiveCamera) { expect_same(test::dots(), true); }
TEST(TwoCores, SegmentsGiveTheBitsOfOneOnATexture) { expect_same(test::texture(), false); }

TEST(TwoCores, SegmentsGiveTheBitsOfOneOfDepthAlone) {
  test::Scene scene = test::dots();
  scene.board.stages = {"difference", "markers", "photometric", "poisson"};
  expect_same(scene, false);
}

TEST(TwoCores, PicturesTakenOutOfAPathAreNotThoseOfAnotherFrame) {
  const test::Scene scene = on_cores(test::dots(), 2);
  const auto path = path_of(scene);
  const auto show = [&](const std::vector<uint8_t>& pixels) {
    path->process({pixels.data(), scene.board.camera.width_px, scene.board.camera.height_px, 3,
                   ptrdiff_t{3} * scene.board.camera.width_px});
    return path->state().difference.grey;
  };
  for (int i = 0; i < scene.board.n_rest_frames; ++i) show(scene.rest);
  const std::vector<uint16_t> rest = show(scene.rest);
  const std::vector<uint16_t> pressed = show(scene.pressed);
  EXPECT_NE(rest, pressed);
  EXPECT_EQ(show(scene.rest), rest);
  EXPECT_EQ(show(scene.pressed), pressed);
}

// Before each frame calls `before`.
class StagedCamera : public Camera {
 public:
  StagedCamera(const test::Scene& scene, uint64_t n_frames, std::function<void(uint64_t)> before)
      : scene_(scene), n_frames_(n_frames), before_(std::move(before)) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (n_ == n_frames_) return CaptureStatus::kEnd;
    before_(n_);
    const bool is_rest = n_ < static_cast<uint64_t>(scene_.board.n_rest_frames) || n_ / 4 % 2 == 0;
    buffer.pixels = is_rest ? scene_.rest : scene_.pressed;
    buffer.pixels[n_ % buffer.pixels.size()] ^= 1;
    buffer.number = n_++;
    buffer.capture_us = kFrameUs * n_;
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  const test::Scene& scene_;
  uint64_t n_frames_;
  std::function<void(uint64_t)> before_;
  uint64_t n_ = 0;
};

using Payloads = std::vector<std::vector<uint8_t>>;

// By type of message, what a host reads; STATUS has times.
std::array<Payloads, kMessageTypes> run_daemon(const test::Scene& scene, uint64_t n_frames,
                                               const std::function<void(uint64_t, Exchange&)>& before) {
  Exchange exchange;
  int n_saved = 0;  // rest images
  for (int type = ruffini_MessageType_MESSAGE_TYPE_STATUS + 1; type <= ruffini_MessageType_MESSAGE_TYPE_IMAGE; ++type) {
    exchange.every[static_cast<size_t>(type)] = 1;
  }
  exchange.every[ruffini_MessageType_MESSAGE_TYPE_RESIDUAL] = 1;
  exchange.every[ruffini_MessageType_MESSAGE_TYPE_FEATURES] = 1;
  const std::string folder =
      testing::TempDir() + "two_cores_store" + std::to_string(scene.board.n_cores) + std::to_string(::getpid());
  Calibrator calibrator(scene.board, "0000", SlotStore::open(folder).value(), exchange);
  auto port = std::make_unique<SerialPort>(SerialPort::open("pty").value());
  const int host = ::open(port->host_path().c_str(), O_RDONLY | O_NOCTTY);
  EXPECT_GE(host, 0);
  const SystemClock clock;
  SystemRandom random;
  auto camera = std::make_unique<StagedCamera>(scene, n_frames, [&](uint64_t number) { before(number, exchange); });
  auto daemon = std::make_unique<Daemon>(
      scene.board, path_of(scene),
      DaemonDevices{.clock = clock,
                    .random = random,
                    .camera = std::move(camera),
                    .link = std::move(port),
                    .io = std::make_unique<Thermometer>("")},
      calibrator, exchange,
      DeviceIdentity{.serial = "0000", .version = "test", .stream_flags = kSimulated, .is_lossless = true},
      DaemonOptions{.is_lockstep = true, .save_rest = [&](std::span<const uint16_t> rest) {
                      ++n_saved;
                      EXPECT_NE(std::accumulate(rest.begin(), rest.end(), uint64_t{0}), 0U);
                    }});
  std::array<Payloads, kMessageTypes> out{};
  std::thread reader([&] {
    FrameDecoder decoder;
    std::vector<uint8_t> bytes(65'536);
    while (true) {
      const ssize_t n = ::read(host, bytes.data(), bytes.size());
      if (n <= 0) break;
      for (ssize_t i = 0; i < n; ++i) {
        const auto frame = decoder.push(bytes[static_cast<size_t>(i)]);
        if (frame) out[frame->header.type].emplace_back(frame->payload.begin(), frame->payload.end());
      }
    }
  });
  const std::atomic<bool> stop{false};
  daemon->run(stop);
  EXPECT_EQ(exchange.frames_processed, n_frames);
  EXPECT_GT(n_saved, 0);
  daemon.reset();  // closes the line: the reader ends
  reader.join();
  ::close(host);
  std::filesystem::remove_all(folder);
  delete exchange.next_path.exchange(nullptr);
  delete exchange.retired_path.exchange(nullptr);
  out[ruffini_MessageType_MESSAGE_TYPE_STATUS].clear();
  return out;
}

void wait_for_frames(const Exchange& exchange, uint64_t n) {
  while (exchange.frames_processed < n) std::this_thread::yield();
}

TEST(TwoCores, TheLineIsTheSameWithARestAndACalibrationOnTheWay) {
  constexpr uint64_t kFrames = 120;
  std::array<std::array<Payloads, kMessageTypes>, 2> lines;
  for (const int n_cores : {1, 2}) {
    const test::Scene scene = on_cores(test::dots(), n_cores);
    lines[static_cast<size_t>(n_cores - 1)] = run_daemon(scene, kFrames, [&](uint64_t number, Exchange& exchange) {
      if (number != 40 && number != 80) return;
      wait_for_frames(exchange, number);  // that the request meets the same frame
      if (number == 80) delete exchange.next_path.exchange(path_of(scene).release());
      if (number == 40) {
        exchange.zero_even_if_touched = true;
        exchange.zero_frames = 3;
      }
    });
  }
  for (const auto type : {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_FIELD,
                          ruffini_MessageType_MESSAGE_TYPE_DEPTH, ruffini_MessageType_MESSAGE_TYPE_CONTACTS,
                          ruffini_MessageType_MESSAGE_TYPE_MARKERS, ruffini_MessageType_MESSAGE_TYPE_RESIDUAL}) {
    EXPECT_GE(lines[0][type].size(), kFrames) << type;
  }
  for (size_t type = 0; type < kMessageTypes; ++type) EXPECT_EQ(lines[0][type], lines[1][type]) << type;
}

// As a host's requests come: while two frames are on their way.
TEST(TwoCores, RequestsMeetFramesOnTheirWay) {
  const test::Scene scene = on_cores(test::dots(), 2);
  constexpr uint64_t kFrames = 200;
  const auto line = run_daemon(scene, kFrames, [&](uint64_t number, Exchange& exchange) {
    if (number % 20 == 10) exchange.zero_frames = 2;
    if (number % 20 == 15) exchange.zero_frames = kCancelZero;
    if (number % 50 == 25) delete exchange.next_path.exchange(path_of(scene).release());
  });
  EXPECT_EQ(line[ruffini_MessageType_MESSAGE_TYPE_WRENCH].size(), kFrames);
}

}  // namespace
}  // namespace ruffini
