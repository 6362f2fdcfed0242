#include "world.h"

#include <algorithm>
#include <array>

#include "failure.h"
#include "store/slot_store.h"
#include "support/fake_seams.h"

namespace ruffini::sim {
namespace {

constexpr uint64_t kNever = UINT64_MAX;
constexpr uint64_t kServeUs = 10'000;       // the link thread looks at least so often
constexpr uint64_t kReopenUs = 10'000;      // as daemon.cpp
constexpr uint64_t kRestartUs = 1'000'000;  // of the service, and of the board
constexpr uint64_t kChaosStepUs = 100'000;
constexpr uint64_t kGreetedUs = 10'000'000;  // at the latest when nothing goes wrong
constexpr uint64_t kFlashedUs = 60'000'000;
constexpr uint64_t kForcesUs = 5'000'000;

class VirtualClock final : public Clock {
 public:
  explicit VirtualClock(const uint64_t& now_us) : now_us_(now_us) {}
  [[nodiscard]] uint64_t now_us() const override { return now_us_; }

 private:
  const uint64_t& now_us_;
};

class NoIo final : public BoardIo {
 public:
  [[nodiscard]] std::optional<int32_t> milli_celsius() const override { return std::nullopt; }
};

// One run of the daemon.
struct Device {
  ~Device() {
    delete exchange.next_path.exchange(nullptr);
    delete exchange.retired_path.exchange(nullptr);
  }
  Exchange exchange;
  std::optional<Calibrator> calibrator;
  std::optional<Daemon> daemon;
  const SimCamera* camera = nullptr;
};

class World {
 public:
  World(const TinySensor& sensor, uint64_t seed, bool keeps_text)
      : sensor_(sensor),
        log_(keeps_text),
        dice_(seed),
        swarm_(dice_.fork()),
        line_(dice_.fork(), swarm_, log_, now_us_),
        disk_(dice_.fork(), swarm_),
        judge_(sensor, disk_, log_, now_us_),
        host_(sensor, dice_.fork(), swarm_, line_, judge_, log_, now_us_) {
    line_.on_sent = [this](std::span<const uint8_t> bytes) { judge_.sent(bytes); };
    line_.on_received = [this](std::span<const uint8_t> bytes) { judge_.received(bytes); };
    scene_.period_us = std::array<uint64_t, 4>{8'333, 16'667, 16'667, 33'333}[dice_.below(4)];
  }

  void run(uint64_t chaos_us) {
    run_until(chaos_us, [] { return false; });
    calm();
    expect(kGreetedUs, [this] { return host_.is_greeted(); }, "the device answers once nothing goes wrong any more");
    const Table& table = sensor_.tables[host_.in_force() == sensor_.tables[0].sha256 ? 1 : 0];
    host_.flash_now(table);
    expect(kFlashedUs, [this] { return host_.has_flashed(); }, "a good table can be flashed once nothing goes wrong");
    expect_forces();
    cut_power();
    expect_forces();
    want(device_ && device_->calibrator->active().sha256 == table.sha256,
         "what was said to be in force is so after a power cut");
  }

  void tell(Outcome& out) const {
    out.at_us = out.simulated_us = now_us_;
    out.hash = log_.hash();
    out.text = log_.text();
    out.n_frames = n_frames_;
    out.n_valid_forces = judge_.n_valid_forces();
    out.n_stale = judge_.n_stale();
    out.n_confirmed = judge_.n_confirmed();
    out.n_reverted = judge_.n_reverted();
    out.n_starts = n_starts_;
    out.faults = swarm_.counts();
  }

 private:
  template <typename Done>
  void run_until(uint64_t end_us, Done done) {
    while (!done()) {
      const uint64_t next_us = std::min({capture_us_, frame_us_, serve_us_, reopen_us_, host_us_, chaos_us_, boot_us_});
      if (next_us >= end_us) {
        now_us_ = std::max(now_us_, end_us);
        return;
      }
      now_us_ = std::max(now_us_, next_us);
      step();
    }
  }
  template <typename Done>
  void expect(uint64_t within_us, Done done, const char* promise) {
    run_until(now_us_ + within_us, done);
    want(done(), promise);
  }
  void expect_forces() {
    const uint64_t before = host_.n_fresh_forces();
    expect(
        kForcesUs, [&] { return host_.n_fresh_forces() > before + 10; },
        "forces come once nothing goes wrong any more");
  }

  void step() {
    if (boot_us_ <= now_us_) boot();
    if (capture_us_ <= now_us_) capture();
    if (frame_us_ <= now_us_) frame();
    if (reopen_us_ <= now_us_) reopen();
    if (serve_us_ <= now_us_) serve();
    if (host_us_ <= now_us_) host_us_ = host_.step();
    if (chaos_us_ <= now_us_) stir();
    if (device_ && reopen_us_ == kNever)
      serve_us_ = std::min(serve_us_, std::max(line_.next_for_device_us(), now_us_ + 1));
  }

  void boot() {
    boot_us_ = kNever;
    disk_.forget_failures();
    auto device = std::make_unique<Device>();
    try {
      device->calibrator.emplace(sensor_.board, kSerial, SlotStore::open(std::make_unique<DiskEnd>(disk_)),
                                 device->exchange);
      std::string problem;
      auto path = device->calibrator->start([] { return uint64_t{0}; }, problem);
      if (!path) return fail_to_start();
      auto camera = std::make_unique<SimCamera>(sensor_, scene_, dice_.fork(), swarm_, now_us_);
      device->camera = camera.get();
      const DeviceIdentity identity{.serial = kSerial,
                                    .version = "simulation",
                                    .session_id = static_cast<uint32_t>(dice_.next()),
                                    .stream_flags = kSimulated};
      device->daemon.emplace(sensor_.board, std::move(path).value(),
                             DaemonDevices{.clock = clock_,
                                           .random = random_,
                                           .camera = std::move(camera),
                                           .link = std::make_unique<LineEnd>(line_),
                                           .io = std::make_unique<NoIo>()},
                             *device->calibrator, device->exchange, identity, DaemonOptions());
      ++n_starts_;
      log_.say(now_us_, "the device starts");
      judge_.booted(*device->calibrator, device->exchange, *device->camera, problem);
    } catch (const PowerCut&) {
      log_.say(now_us_, "the power goes while the device starts");
      disk_.lose_power();
      return fail_to_start();
    }
    device_ = std::move(device);
    line_.device_open();
    serve_us_ = now_us_;
    capture_us_ = device_->camera->due_us();
  }

  void fail_to_start() { boot_us_ = now_us_ + kRestartUs; }

  void stop(bool in_store) {
    if (device_) n_frames_ += device_->exchange.frames_processed;
    judge_.stopped(in_store);
    device_.reset();
    line_.device_close();
    line_.hang_up();
    capture_us_ = frame_us_ = serve_us_ = reopen_us_ = kNever;
    boot_us_ = now_us_ + kRestartUs;
  }

  void cut_power() {
    log_.say(now_us_, "the power goes");
    stop(false);
    disk_.lose_power();
    plug_us_ = now_us_ + kRestartUs;
  }

  void capture() {
    // Nothing touches while rest is learned: a person sees FLAG_NO_REFERENCE.
    const Exchange& e = device_->exchange;
    const bool has_rest = e.frames_processed > 0 && (e.flags & kFlagNoReference) == 0 && e.zero_frames < 0;
    scene_.is_lifted = !has_rest || host_.keeps_hands_off();
    const uint64_t n_before = frames_waiting();
    device_->daemon->capture_once();
    capture_us_ = device_->camera->due_us();
    const bool is_waiting = frames_waiting() > n_before || n_before > 0;
    judge_.after_capture(is_waiting);
    if (is_waiting && frame_us_ == kNever) {
      frame_us_ = now_us_ + dice_.between(300, 3'000);
      if (swarm_.strikes(Fault::kSlowFrames, 20'000)) frame_us_ += dice_.below(150'000);
    }
  }
  [[nodiscard]] uint64_t frames_waiting() const {
    const Exchange& e = device_->exchange;
    return e.frames_captured - e.frames_processed - e.frames_overrun - e.frames_invalid - e.frames_repeated -
           e.frames_left_out;
  }

  void frame() {
    frame_us_ = kNever;
    if (!device_->daemon->process_once()) return;
    judge_.after_frame();
    serve_us_ = std::min(serve_us_, now_us_ + 1);
  }

  void reopen() {
    reopen_us_ = kNever;
    device_->daemon->reopen_line();
    serve_us_ = now_us_;
  }

  void serve() {
    serve_us_ = now_us_ + kServeUs;
    if (swarm_.strikes(Fault::kSlowLink, 1'000)) serve_us_ += dice_.below(200'000);
    judge_.before_serving();
    try {
      const bool is_up = device_->daemon->serve_once(0);
      judge_.after_serving(is_up, line_.has_room());
      if (is_up) return;
      serve_us_ = kNever;
      reopen_us_ = now_us_ + kReopenUs;
    } catch (const PowerCut&) {
      log_.say(now_us_, "the power goes in the store");
      stop(true);
      disk_.lose_power();
      plug_us_ = now_us_ + kRestartUs;
    }
  }

  // What happens of itself, and what people do.
  void stir() {
    chaos_us_ = now_us_ + dice_.between(kChaosStepUs / 2, kChaosStepUs);
    if (!line_.is_connected() && now_us_ >= plug_us_) {
      line_.connect();
      host_us_ = now_us_;
    }
    if (dice_.chance(200'000)) scene_.touch = static_cast<uint8_t>(dice_.below(kTouches));
    if (swarm_.strikes(Fault::kHangUp, 5'000)) unplug();
    if (swarm_.strikes(Fault::kGarbage, 10'000)) garbage();
    if (swarm_.strikes(Fault::kCameraStalls, 5'000))
      scene_.stalled_until_us = now_us_ + dice_.between(20'000, 6'000'000);
    spoil(Fault::kDark, kDarkPicture);
    spoil(Fault::kGlare, kGlarePicture);
    spoil(Fault::kNoise, kNoisePicture);
    if (dice_.chance(10'000)) disk_.set_failing(swarm_.has(Fault::kDiskError) && dice_.chance(kMillion / 2));
    if (swarm_.has(Fault::kCutInStore) && dice_.chance(20'000)) disk_.cut_at_call(dice_.between(1, 40));
    if (device_ && swarm_.strikes(Fault::kCrash, 2'000)) {
      log_.say(now_us_, "the daemon dies");
      stop(false);
      plug_us_ = now_us_ + dice_.below(kRestartUs);
    }
    if (device_ && swarm_.strikes(Fault::kPowerCut, 2'000)) cut_power();
  }

  void spoil(Fault fault, uint8_t picture) {
    if (!swarm_.strikes(fault, 5'000)) return;
    scene_.spoilt = picture;
    scene_.spoilt_until_us = now_us_ + dice_.between(10'000, 8'000'000);
  }
  void unplug() {
    line_.hang_up();
    plug_us_ = now_us_ + dice_.below(3'000'000);
  }
  // A modem's prober, or noise.
  void garbage() {
    std::vector<uint8_t> bytes(dice_.between(1, 300));
    const bool is_probe = dice_.chance(kMillion / 2);
    for (size_t i = 0; i < bytes.size(); ++i) {
      bytes[i] = is_probe ? static_cast<uint8_t>("AT\r"[i % 3]) : static_cast<uint8_t>(dice_.next());
    }
    line_.host_write(bytes);
  }

  void calm() {
    log_.say(now_us_, "calm");
    swarm_.calm();
    disk_.set_failing(false);
    disk_.cut_at_call(0);
    scene_.stalled_until_us = scene_.spoilt_until_us = now_us_;
    plug_us_ = std::min(plug_us_, now_us_);
  }

  const TinySensor& sensor_;
  uint64_t now_us_ = 1'000'000;
  VirtualClock clock_{now_us_};
  test::FakeRandom random_;
  EventLog log_;
  Dice dice_;
  Swarm swarm_;
  SimLine line_;
  Disk disk_;
  SimCamera::Scene scene_;
  Judge judge_;
  Host host_;
  std::unique_ptr<Device> device_;
  uint64_t n_frames_ = 0;
  uint64_t n_starts_ = 0;
  uint64_t plug_us_ = 0;
  // When each is next.
  uint64_t capture_us_ = kNever;
  uint64_t frame_us_ = kNever;
  uint64_t serve_us_ = kNever;
  uint64_t reopen_us_ = kNever;
  uint64_t host_us_ = 0;
  uint64_t chaos_us_ = 0;
  uint64_t boot_us_ = 0;
};

}  // namespace

Outcome simulate(const TinySensor& sensor, uint64_t seed, uint64_t chaos_us, bool keeps_text) {
  World world(sensor, seed, keeps_text);
  Outcome out;
  try {
    world.run(chaos_us);
  } catch (const Failure& failure) {
    out.broken = failure.what();
  }
  world.tell(out);
  return out;
}

}  // namespace ruffini::sim
