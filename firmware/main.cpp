// ruffinid: composition root. The implementation is in the folders beside this file (README.md).
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <malloc.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <array>
#include <bit>
#include <csignal>
#include <cstdio>
#include <filesystem>

#include "board/parse.h"
#include "capture/alternating_camera.h"
#include "capture/libcamera_camera.h"
#include "capture/paired_camera.h"
#include "capture/replay_camera.h"
#include "capture/twin_camera.h"
#include "capture/v4l2_camera.h"
#include "capture/v4l2_modes.h"
#include "daemon.h"
#include "hw/doctor.h"
#include "hw/linux_board.h"
#include "hw/pad_hardware.h"
#include "hw/strobe.h"
#include "hw/system.h"
#include "hw/thread_place.h"
#include "link/proto_text.h"
#include "link/serial_port.h"
#include "store/folder_storage.h"
#include "store/last_run.h"
#include "store/own_serial.h"
#include "store/rest_file.h"

#ifndef RUFFINI_VERSION
#define RUFFINI_VERSION "0"
#endif
#ifndef RUFFINI_BOARDS_DIR
#define RUFFINI_BOARDS_DIR "/usr/share/ruffini/boards"
#endif

namespace {

// Exit codes, as in the host tool.
constexpr int kExitUsage = 2;
constexpr int kExitNoDevice = 3;
constexpr int kExitRefused = 4;
constexpr int kExitVerify = 5;

std::atomic<bool> stop_requested{false};

void request_stop(int) { stop_requested = true; }

int fail(const ruffini::Error& error) {
  fmt::print(stderr, "ruffinid: {}\n", error.message);
  switch (error.kind) {
    case ruffini::ErrorKind::kBadInput:
      return kExitUsage;
    case ruffini::ErrorKind::kUnavailable:
    case ruffini::ErrorKind::kBusy:
      return kExitNoDevice;
    case ruffini::ErrorKind::kRefused:
      return kExitRefused;
    case ruffini::ErrorKind::kStorage:
      return kExitVerify;
  }
  return 1;
}

uint64_t now_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

// Stack size that a thread gets; OpenCV crashes with less, without any message.
ruffini::Status has_stack() {
  constexpr rlim_t kMinBytes = rlim_t{512} << 10;
  rlimit stack{};
  if (::getrlimit(RLIMIT_STACK, &stack) != 0 || stack.rlim_cur >= kMinBytes) return ruffini::Unit{};
  return ruffini::Error{ruffini::ErrorKind::kBadInput,
                        fmt::format("the stack is limited to {} KiB: {} are needed, raise it (ulimit -s 8192, or "
                                    "LimitSTACK=8M in the service)",
                                    stack.rlim_cur >> 10, kMinBytes >> 10)};
}

struct Arguments {
  std::string board;
  std::string boards_dir = RUFFINI_BOARDS_DIR;
  std::vector<std::string> cameras;
  std::string link;
  std::string store;
  std::string serial;
  std::string keys;
  std::string factory;
  std::string throttled;
  std::string clock;
  bool accepts_development_key = false;
  bool has_no_challenge = false;
  bool is_loop = false;
  bool locks_memory = false;
  bool is_doctor = false;
  bool is_lights_off = false;
  bool is_json = false;
  ruffini::DaemonOptions daemon;
};

ruffini::Result<ruffini::BoardSettings> load_board(const Arguments& arguments) {
  namespace fs = std::filesystem;
  return ruffini::load_board(fs::exists(fs::path(arguments.board) / "board.toml")
                                 ? arguments.board
                                 : (fs::path(arguments.boards_dir) / arguments.board).string());
}

ruffini::Result<std::unique_ptr<ruffini::Camera>> open_one(const std::string& camera, const Arguments& arguments,
                                                           const ruffini::BoardSettings& board,
                                                           const ruffini::Clock& clock) {
  const bool is_lockstep = arguments.daemon.is_lockstep;
  if (camera.rfind("libcamera:", 0) == 0) return ruffini::open_libcamera(camera.substr(10), board);
  if (camera.rfind("v4l2:", 0) == 0) return ruffini::open_v4l2(camera.substr(5), board);
  if (camera.starts_with("twin:")) {
    return ruffini::open_twin(ruffini::FrameSender::kTwin, camera.substr(5), is_lockstep, board, clock);
  }
  if (camera.starts_with("frames:")) {
    return ruffini::open_twin(ruffini::FrameSender::kRecording, camera.substr(7), is_lockstep, board, clock);
  }
  if (camera.rfind("replay:", 0) == 0) {
    return ruffini::open_replay({camera.substr(7), is_lockstep, arguments.is_loop}, board, clock);
  }
  return ruffini::Error{
      ruffini::ErrorKind::kBadInput,
      "--camera " + camera + ": give v4l2:NAME, libcamera:NAME, replay:PATH, twin:SOCKET or frames:SOCKET"};
}

using CameraResult = ruffini::Result<std::unique_ptr<ruffini::Camera>>;

// Opens one camera for the whole picture, or two for half a picture each.
CameraResult open_cameras(const Arguments& arguments, const ruffini::BoardSettings& board,
                          const ruffini::Clock& clock) {
  if (arguments.cameras.size() == 1) return open_one(arguments.cameras[0], arguments, board, clock);
  if (board.stereo.tolerance_us == 0) {
    return ruffini::Error{ruffini::ErrorKind::kBadInput,
                          "--camera is given twice, but board.toml has no [stereo]: give one, or add that section"};
  }
  ruffini::BoardSettings half = board;
  half.camera.width_px /= 2;
  auto left = open_one(arguments.cameras[0], arguments, half, clock);
  if (!left) return left;
  auto right = open_one(arguments.cameras[1], arguments, half, clock);
  if (!right) return right;
  return ruffini::pair_cameras(std::move(left).value(), std::move(right).value(), board.camera.width_px,
                               board.camera.height_px, static_cast<uint64_t>(board.stereo.tolerance_us));
}

// A twin encodes its lamps in the frame numbers; a board's lamps are switched here. Recordings hold pictures that are
// already subtracted.
CameraResult open_alternating(const Arguments& arguments, const ruffini::BoardSettings& board,
                              const ruffini::Clock& clock, ruffini::OutputLine* lamps) {
  ruffini::BoardSettings faster = board;
  faster.camera.rate_mhz *= 2;
  auto camera = open_cameras(arguments, faster, clock);
  if (!camera || camera.value()->is_replay()) return camera;
  const size_t n_bytes = size_t{3} * static_cast<size_t>(board.camera.width_px * board.camera.height_px);
  if (arguments.cameras[0].rfind("twin:", 0) == 0) {
    return ruffini::alternate(std::move(camera).value(), ruffini::lamps_by_number, n_bytes);
  }
  if (lamps == nullptr) {
    return ruffini::Error{ruffini::ErrorKind::kUnavailable,
                          "light.alternation needs the lamps' line, which cannot be had: see the line above"};
  }
  const auto period_us = static_cast<uint64_t>(1'000'000'000 / faster.camera.rate_mhz);
  auto strobe = std::make_shared<ruffini::Strobe>(*lamps, period_us, static_cast<uint64_t>(board.exposure.time_us));
  const auto during = [strobe](const ruffini::FramePool::Buffer& frame) {
    const std::optional<bool> is_lit = strobe->record_frame(frame.capture_us);
    return !is_lit ? ruffini::Lamps::kNotKnown : *is_lit ? ruffini::Lamps::kLit : ruffini::Lamps::kDark;
  };
  fmt::print(stderr, "ruffinid: light.alternation: {} frames a second of the camera, {} pairs\n",
             static_cast<double>(faster.camera.rate_mhz) / 1'000, static_cast<double>(board.camera.rate_mhz) / 1'000);
  return ruffini::alternate(std::move(camera).value(), during, n_bytes);
}

CameraResult open_camera(const Arguments& arguments, const ruffini::BoardSettings& board, const ruffini::Clock& clock,
                         ruffini::OutputLine* lamps) {
  return board.light.alternates ? open_alternating(arguments, board, clock, lamps)
                                : open_cameras(arguments, board, clock);
}

// Checks everything that a start needs. Opens the camera as a start would.
int doctor(const Arguments& arguments) {
  using ruffini::CheckState;
  std::vector<ruffini::Check> checks = ruffini::examine({"", arguments.link, arguments.store});
  const auto board = load_board(arguments);
  if (board) {
    checks.push_back({"board", CheckState::kOk, board.value().name, ""});
    checks.push_back(ruffini::examine_threads(board.value().threads));
    checks.push_back(ruffini::examine_lamps(board.value().led_driver));
    const ruffini::SystemClock clock;
    const auto camera = open_cameras(arguments, board.value(), clock);
    checks.push_back({"frames", camera ? CheckState::kOk : CheckState::kFailed,
                      camera ? fmt::format("{}", fmt::join(arguments.cameras, ", ")) : camera.error().message, ""});
  } else {
    checks.push_back({"board", CheckState::kFailed, board.error().message, ""});
  }
  fmt::print("{}", arguments.is_json ? ruffini::as_json(checks) : ruffini::as_text(checks));
  return ruffini::has_failed(checks) ? 1 : 0;
}

int run(const Arguments& arguments) {
  namespace fs = std::filesystem;
  if (arguments.is_doctor) return doctor(arguments);
  auto board = load_board(arguments);
  if (!board) return fail(board.error());
  if (arguments.is_lights_off) {
    const std::string problem = ruffini::PadHardware::lights_off(board.value());
    return problem.empty() ? 0 : fail({ruffini::ErrorKind::kUnavailable, problem});
  }
  constexpr size_t kMaxSerialBytes = sizeof ruffini_Hello::device_serial - 1;
  if (arguments.serial.size() > kMaxSerialBytes) {
    return fail({ruffini::ErrorKind::kBadInput,
                 fmt::format("--serial {}: give at most {} bytes", arguments.serial, kMaxSerialBytes)});
  }
  if (const std::string shown = ruffini::to_plain_ascii(arguments.serial); shown != arguments.serial) {
    return fail({ruffini::ErrorKind::kBadInput,
                 fmt::format("--serial {}: holds what is no printable ASCII: give letters, digits and - _ .", shown)});
  }
  // Pages touched from here on stay in memory, so that no frame waits for the SD card.
  const bool is_memory_locked = arguments.locks_memory && ::mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0;
  if (arguments.locks_memory && !is_memory_locked) {
    fmt::print(stderr,
               "ruffinid: --lock-memory: not allowed, frames may wait for the disk: set LimitMEMLOCK=infinity in the "
               "service, or ulimit -l unlimited\n");
  }
  auto pad = ruffini::PadHardware::open(board.value());
  if (!pad) return fail(pad.error());
  if (!pad.value().lamp_error().empty()) fmt::print(stderr, "ruffinid: {}\n", pad.value().lamp_error());
  const bool is_lockstep = arguments.daemon.is_lockstep;
  auto clock = arguments.clock.empty()
                   ? ruffini::Result<std::unique_ptr<ruffini::Clock>>(std::make_unique<ruffini::SystemClock>())
                   : ruffini::FileClock::open(arguments.clock);
  if (!clock) return fail(clock.error());
  auto camera = open_camera(arguments, board.value(), *clock.value(), pad.value().lamps());
  if (!camera) return fail(camera.error());
  ruffini::SystemRandom random;
  const std::string serial = !arguments.serial.empty()            ? arguments.serial
                             : pad.value().board_serial().empty() ? ruffini::own_serial(arguments.store, random)
                                                                  : pad.value().board_serial();
  auto store = ruffini::SlotStore::open(pad.value().store_folder(arguments.store));
  if (!store) return fail(store.error());
  const ruffini::RunRecord record(arguments.store);
  ruffini::DaemonOptions options = arguments.daemon;
  options.hardware_fault = [&pad] { return pad.value().gel_fault(); };
  options.has_light_fault = [&pad, said = std::string()](std::optional<int32_t> milli_celsius) mutable {
    const std::string fault = pad.value().lamp_fault(milli_celsius);
    if (!fault.empty() && fault != said && fault != pad.value().lamp_error())
      fmt::print(stderr, "ruffinid: {}\n", fault);
    said = fault;
    return !fault.empty();
  };
  auto rest_medium = ruffini::FolderStorage::open(pad.value().store_folder(arguments.store));
  if (!rest_medium) return fail(rest_medium.error());
  const auto [width_px, height_px] = std::pair(board.value().camera.width_px, board.value().camera.height_px);
  options.previous_rest = ruffini::load_rest(*rest_medium.value(), width_px, height_px);
  options.save_rest = [&medium = *rest_medium.value(), width_px, height_px](std::span<const uint16_t> rest) {
    const ruffini::Status kept = ruffini::save_rest(medium, rest, width_px, height_px);
    if (!kept) fmt::print(stderr, "ruffinid: {}: the next start cannot be compared with rest\n", kept.error().message);
  };
  options.on_thread_start = [&board](const char* role) {
    const std::string problem = ruffini::place_thread(role, ruffini::thread_of(board.value().threads, role));
    if (!problem.empty()) fmt::print(stderr, "ruffinid: {}\n", problem);
  };
  if (!board.value().learned.network.empty() && !record.is_safe_mode()) {
    const std::string path = (fs::path(arguments.store) / board.value().learned.network).string();
    options.network = [path, settings = board.value()] { return ruffini::load_network(path, settings); };
  }
  auto port = ruffini::SerialPort::open(arguments.link);
  if (!port) return fail(port.error());

  ruffini::Exchange exchange(ruffini::telemetry_ring_bytes(board.value()));
  // A recording shows each frame once: a trial would consume frames that the host wants.
  const bool is_once = camera.value()->is_replay() && !arguments.is_loop;
  const bool has_trial = !is_once && !arguments.daemon.waits_for_host && !is_lockstep;
  auto keys = arguments.keys.empty() ? ruffini::Result<ruffini::KeyRing>(ruffini::KeyRing())
                                     : ruffini::KeyRing::load(arguments.keys, arguments.accepts_development_key);
  if (!keys) return fail(keys.error());
  options.is_open = arguments.has_no_challenge || !keys.value().has_enrolled();
  ruffini::Calibrator calibrator(board.value(), serial, std::move(store).value(), exchange,
                                 has_trial ? ruffini::TrialRule() : ruffini::TrialRule{0, 0}, std::move(keys).value());
  if (!arguments.factory.empty()) {
    auto factory = ruffini::read_file(arguments.factory);
    if (!factory) return fail(factory.error());
    calibrator.set_factory(std::move(factory).value());
  }
  std::string problem;
  auto path = record.is_safe_mode() ? calibrator.start_safe(now_ns, problem) : calibrator.start(now_ns, problem);
  if (!path) return fail(path.error());
  if (!problem.empty()) fmt::print(stderr, "ruffinid: {}\n", problem);
  ruffini::RunRecord::note_calibration(path.value()->calibration_id());
  std::string no_reflex;
  const ruffini::LinuxPlaces places{board.value().temperature.path, arguments.throttled, board.value().reflex.chip,
                                    board.value().reflex.line};
  auto io = std::make_unique<ruffini::LinuxBoard>(places, ruffini::NotifySocket::from_environment(), no_reflex);
  if (!no_reflex.empty()) fmt::print(stderr, "ruffinid: {}\n", no_reflex);
  fmt::print("link: {}\n", port.value().host_path());
  std::fflush(stdout);

  const int stream_flags =
      (camera.value()->is_simulated() ? ruffini::kSimulated : 0) | (camera.value()->is_replay() ? ruffini::kReplay : 0);
  std::array<uint8_t, sizeof(uint32_t)> session{};
  random.fill(session);
  const ruffini::DeviceIdentity identity{.serial = serial,
                                         .version = RUFFINI_VERSION,
                                         .session_id = std::bit_cast<uint32_t>(session),
                                         .sensor = 0,
                                         .stream_flags = static_cast<uint8_t>(stream_flags),
                                         .is_lossless = arguments.daemon.is_lockstep,
                                         .last_run = record.last(),
                                         .is_safe_mode = record.is_safe_mode(),
                                         .is_memory_locked = is_memory_locked};
  ruffini::DaemonDevices around{.clock = *clock.value(),
                                .random = random,
                                .camera = std::move(camera).value(),
                                .link = std::make_unique<ruffini::SerialPort>(std::move(port).value()),
                                .io = std::move(io)};
  ruffini::Daemon daemon(board.value(), std::move(path).value(), std::move(around), calibrator, exchange, identity,
                         std::move(options));
  daemon.run(stop_requested);
  const std::string lost = daemon.problem();
  return lost.empty() || stop_requested ? 0 : fail({ruffini::ErrorKind::kUnavailable, lost});
}

}  // namespace

int main(int argc, char** argv) {
  if (const ruffini::Status stack = has_stack(); !stack) return fail(stack.error());
  Arguments arguments;
  CLI::App app{
      "ruffinid: frames in, forces out. Exit codes: 0 ok, 2 usage or bad input, 3 no device, 4 refused, 5 storage"};
  app.set_version_flag("--version", RUFFINI_VERSION);
  app.add_option("--board", arguments.board, "board name, or a folder with a board.toml")->required();
  app.add_option("--boards-dir", arguments.boards_dir, "where board names are looked up");
  app.add_option(
         "--camera", arguments.cameras,
         "v4l2:NAME, the path of a camera's node, a part of its name, its serial number, or nothing; libcamera:NAME, a "
         "part of its id, or nothing; replay:PATH, a video file or a folder of images; "
         "twin:SOCKET of `ruffini sim serve`; frames:SOCKET of `ruffini live`. Twice with [stereo] of board.toml: "
         "left, then right")
      ->required()
      ->expected(1, 2)
      ->allow_extra_args(false);
  app.add_flag_callback(
      "--list-cameras",
      [] {
        fmt::print("{}\n", ruffini::cameras_json(ruffini::VideoCalls::of_kernel()));
        throw CLI::Success();
      },
      "print the V4L2 cameras of this computer with their modes as one JSON object, and do nothing else");
  app.add_option("--link", arguments.link, "serial device, pty, or pty:SYMLINK")->required();
  app.add_option("--store", arguments.store, "folder that keeps the calibration")->required();
  app.add_option(
      "--serial", arguments.serial,
      "serial number of this unit; empty: what its EEPROM says, else one of its own that is kept in --store");
  app.add_option("--keys", arguments.keys, "folder of public keys (NAME.pub) whose calibrations are taken");
  app.add_option("--factory", arguments.factory, "calibration for where the store has none that can be used");
  app.add_flag("--development-key", arguments.accepts_development_key,
               "take the public development key's, too, though keys are enrolled");
  app.add_flag("--lock-memory", arguments.locks_memory, "no page that was used leaves memory");
  app.add_flag("--doctor", arguments.is_doctor, "say what is missing on this computer, with the remedy; exit code 1");
  app.add_flag("--lights-off", arguments.is_lights_off,
               "switch the board's lamps off, and do nothing else: after a daemon that was killed");
  app.add_flag("--json", arguments.is_json, "what --doctor says as one JSON object");
  app.add_flag("--no-challenge", arguments.has_no_challenge,
               "take commands that change something from anybody on the line, though keys are enrolled");
  app.add_flag("--lockstep", arguments.daemon.is_lockstep, "every frame in order, none dropped");
  app.add_flag("--loop", arguments.is_loop, "start the recording again at its end");
  app.add_flag("--wait-for-host", arguments.daemon.waits_for_host, "start when a host has subscribed");
  app.add_flag("--linger", arguments.daemon.keeps_link_open, "keep the link after the recording's end");
  app.add_option("--throttled", arguments.throttled,
                 "file with the computer's throttling bits, e.g. /sys/devices/platform/soc/soc:firmware/get_throttled");
  app.add_option("--clock", arguments.clock,
                 "for tests: a file whose first 8 bytes are the time, microseconds, little endian");
  app.add_option("--frames", arguments.daemon.max_frames, "stop after so many frames");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kExitUsage;
  }
  // Fixed, so that what was read at the start goes back to the system: freeing a calibration would raise it.
  constexpr int kOwnMappingBytes = 128 << 10;
  ::mallopt(M_MMAP_THRESHOLD, kOwnMappingBytes);
  struct sigaction action{};
  action.sa_handler = request_stop;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGHUP, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);  // a write beyond the limit fails and is reported
  try {
    return run(arguments);
  } catch (const std::exception& error) {
    fmt::print(stderr, "ruffinid: {}\n", error.what());
    return 1;
  }
}
