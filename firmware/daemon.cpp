#include "daemon.h"

#include <algorithm>
#include <chrono>
#include <optional>

#include "hw/thread_place.h"
#include "store/last_run.h"

namespace ruffini {
namespace {

constexpr int kBuffers = 3;  // one captured, one posted, one processed; another with a second frame thread
constexpr int kLinkPollMs = 2;
constexpr uint64_t kBoardHealthUs = 1'000'000;  // interval of reading the board's health
constexpr uint64_t kDrainUs = 20'000'000;       // for a reader that accepts nothing after a recording's end
constexpr uint64_t kQuietUs = 100'000;          // a tty that appears empty may still get data from the kernel
constexpr auto kReopenPause = std::chrono::milliseconds(10);  // short, so that a host that returns does not wait

int n_buffers(const BoardSettings& board, const DaemonOptions& options) {
  return kBuffers + (board.n_cores - 1) + (options.network ? Inference::kBuffers : 0);
}

}  // namespace

Daemon::Daemon(const BoardSettings& board, std::unique_ptr<FramePath> path, DaemonDevices devices,
               Calibrator& calibrator, Exchange& exchange, DeviceIdentity identity, DaemonOptions options)
    : board_(board),
      path_(std::move(path)),
      devices_(std::move(devices)),
      exchange_(exchange),
      identity_(std::move(identity)),
      options_(std::move(options)),
      reflex_(board.reflex),
      governor_(1'000'000'000 / static_cast<uint64_t>(board.camera.rate_mhz)),
      liveness_(devices_.io->watchdog_us()),
      session_(board_, *path_, identity_, calibrator, exchange_, {devices_.clock, devices_.random, options_.is_open}),
      encoder_(*path_, identity_.sensor),
      sink_([this](ruffini_MessageType type, std::span<const uint8_t> frames) { publish(type, frames); }),
      pool_(n_buffers(board, options_), board.camera.width_px, board.camera.height_px),
      last_output_us_(devices_.clock.now_us()),
      last_pending_us_(last_output_us_),
      board_health_us_(last_output_us_) {
  path_->set_live(!devices_.camera->is_replay());
  if (options_.save_rest && !devices_.camera->is_replay()) {
    path_->expect_rest(options_.previous_rest);
  } else {
    options_.save_rest = {};
  }
  std::vector<uint16_t>().swap(options_.previous_rest);  // as large as two pictures
  if (!board.reflex.line.empty()) {
    exchange_.reflex = devices_.io->has_reflex() ? ReflexState::kOff : ReflexState::kFailed;
  }
  read_board_health();  // before the first frame, because rest is learned at a temperature
  if (!options_.network) return;
  exchange_.network.is_asked = true;
  network_ = std::make_unique<Inference>(options_.network, pool_, n_buffers(board, options_), exchange_.network,
                                         options_.is_lockstep, [this] { begin("inference"); });
}

void Daemon::run(const std::atomic<bool>& stop) {
  stop_ = &stop;
  std::thread capture([this] { capture_loop(); });
  std::thread frame([this] { frame_loop(); });
  link_loop();
  devices_.io->notify_manager("STOPPING=1");
  is_done_ = true;
  // Wakes the capture thread, which may wait for room, and the frame thread, which may wait for a frame.
  if (const std::optional<int> left = mailbox_.close()) pool_.give_back(*left);
  capture.join();
  frame.join();
}

void Daemon::begin(const char* role) {
  RunRecord::name_thread(role);
  if (options_.on_thread_start) options_.on_thread_start(role);
}

void Daemon::capture_loop() {
  using namespace std::chrono_literals;
  begin("capture");
  while (options_.waits_for_host && !is_stopping() &&
         std::none_of(exchange_.every.begin(), exchange_.every.end(), [](const auto& n) { return n.load() != 0; })) {
    std::this_thread::sleep_for(1ms);
  }
  while (!is_stopping() && !mailbox_.is_closed() && capture_once()) continue;
  exchange_.is_camera_live = false;
  mailbox_.wait_empty();  // so that the last frame is taken, too
  mailbox_.close();
}

bool Daemon::capture_once() {
  using namespace std::chrono_literals;
  exchange_.is_camera_live = !options_.is_lockstep;
  const std::optional<int> index = pool_.lend();
  if (!index) {
    ++exchange_.capture_iterations;
    std::this_thread::sleep_for(100us);
    return true;
  }
  FrameLease lease(pool_, *index);
  const CaptureStatus status = devices_.camera->capture(pool_[*index]);
  ++exchange_.capture_iterations;  // before the frame is posted: a frame processed implies that capture went on
  if (status == CaptureStatus::kEnd) return false;
  if (status == CaptureStatus::kNothing) return true;
  ++exchange_.frames_captured;
  if (status == CaptureStatus::kInvalidFrame) {
    ++exchange_.frames_invalid;
    return true;
  }
  if (!take_in_order(pool_[*index])) {
    ++exchange_.frames_repeated;
    return true;
  }
  if (leaves_out()) {
    ++exchange_.frames_left_out;
    return true;
  }
  if (options_.is_lockstep) mailbox_.wait_empty();
  if (const std::optional<int> dropped = mailbox_.post(lease.release())) {
    pool_.give_back(*dropped);
    ++exchange_.frames_overrun;
  }
  return true;
}

bool Daemon::take_in_order(FramePool::Buffer& buffer) {
  buffer.is_time_wrong = false;
  if (devices_.camera->is_replay()) return true;
  const uint64_t now_us = options_.is_lockstep ? 0 : devices_.clock.now_us();
  const FrameOrder::Outcome verdict = order_.check(buffer.number, buffer.capture_us, now_us);
  exchange_.frames_missed += verdict.n_missed;
  buffer.is_time_wrong = verdict.is_time_wrong;
  exchange_.time_faults += verdict.is_time_wrong ? 1U : 0U;
  return verdict.is_used;
}

// Of `rate_divisor` frames one is used.
bool Daemon::leaves_out() {
  n_left_out_ = n_left_out_ + 1 < exchange_.rate_divisor ? n_left_out_ + 1 : 0;
  return n_left_out_ != 0;
}

void Daemon::frame_loop() {
  begin("frame");
  const ThreadPlace place = thread_place();
  exchange_.frame_priority = place.priority;
  exchange_.frame_cpus = place.cpus;
  const bool has_second = path_->n_segments() > 1;
  std::thread second;
  if (has_second) second = std::thread([this] { finish_loop(); });
  uint32_t number = 0;
  for (;; ++number) {
    turns_.wait_to_begin(*path_, number);
    const std::optional<int> index = take_frame(number);
    if (!index) break;
    start(number, FrameLease(pool_, *index));
    if (has_second) {
      Flight& flight = flights_[number % 2];
      turns_.run(*path_, flight.frame, number, cut_.get());
      flight.first_us = devices_.clock.now_us() - flight.start_us;
      turns_.enter(*path_, flight.frame, number);
      handed_.pass();
    } else {
      finish(number, flights_[number % 2].start_us);
    }
  }
  handed_.pass();  // nothing: the end
  if (second.joinable()) second.join();
  is_frame_over_ = true;
  if (const std::optional<int> left = mailbox_.close()) pool_.give_back(*left);
}

// Second frame thread.
void Daemon::finish_loop() {
  begin("frame");
  for (uint32_t number = 0;; ++number) {
    handed_.wait_for(number + 1);
    if (!flights_[number % 2].lease) return;
    finish(number, devices_.clock.now_us());
  }
}

// Waits for a frame. Returns none at the end.
std::optional<int> Daemon::take_frame(uint32_t number) {
  while (!is_stopping() && (options_.max_frames == 0 || number < options_.max_frames)) {
    mailbox_.wait_full();
    if (const std::optional<int> index = mailbox_.take()) return index;
    if (mailbox_.is_closed()) break;
  }
  return std::nullopt;
}

bool Daemon::process_once() {
  const std::optional<int> index = mailbox_.take();
  if (!index) return false;
  start(n_begun_, FrameLease(pool_, *index));
  finish(n_begun_, flights_[n_begun_ % 2].start_us);
  ++n_begun_;
  return true;
}

// `busy_us`: of the frame thread that took longer for the frame. Recordings keep their rate.
void Daemon::govern_rate(uint64_t busy_us) {
  if (options_.is_lockstep || devices_.camera->is_replay()) return;
  const bool is_throttled = (exchange_.throttled & kClockLowered) != 0;
  exchange_.rate_divisor = governor_.update(devices_.clock.now_us(), busy_us, is_throttled);
}

bool Daemon::has_requests() const {
  return exchange_.next_path.load(std::memory_order_relaxed) != nullptr || exchange_.zero_frames != kNoZeroRequest;
}

// Swaps in a new calibration between two frames, keeping the rest image.
void Daemon::swap_path() {
  FramePath* next = exchange_.next_path.exchange(nullptr, std::memory_order_acq_rel);
  if (next != nullptr) {
    next->take_rest(*path_);
    FramePath* old = path_.release();
    path_.reset(next);
    path_->set_live(!devices_.camera->is_replay());
    RunRecord::note_calibration(path_->calibration_id());
    exchange_.tally = PathTally{path_->calibration_id(), 0, 0};
    exchange_.wrong_flags = 0;
    delete exchange_.retired_path.exchange(old, std::memory_order_acq_rel);
  }
  const int zero = exchange_.zero_frames.exchange(kNoZeroRequest);
  if (zero >= 0) path_->zero(zero, !exchange_.zero_even_if_touched);
  if (zero == kCancelZero) path_->cancel_zero();
}

void Daemon::read_board_health() {
  const std::optional<int32_t> milli_celsius = devices_.io->milli_celsius();
  exchange_.milli_celsius = milli_celsius.value_or(kNoTemperature);
  if (options_.has_light_fault) exchange_.has_light_fault = options_.has_light_fault(milli_celsius);
  exchange_.throttled = devices_.io->throttled().value_or(0);
}

// Sends READY once a frame has been processed, or none is expected yet. Feeds the watchdog while the pipeline delivers
// results and every thread makes progress. Link thread.
void Daemon::notify_manager(uint64_t now_us) {
  ++link_iterations_;
  const bool is_live = exchange_.is_camera_live;
  const uint64_t n_frames = exchange_.frames_processed;
  if (!is_ready_reported_ && (n_frames > 0 || !is_live)) {
    is_ready_reported_ = true;
    devices_.io->notify_manager("READY=1");
  }
  const NetworkHealth& network = exchange_.network;
  const bool has_network = network.is_asked && network.state.load() == NetworkState::kRuns;
  if (liveness_.update({{{"capture", exchange_.capture_iterations, is_live},
                         {"frame", n_frames, is_live},
                         {"network", network.results + network.skipped, is_live && has_network},
                         {"link", link_iterations_, true}}},
                       now_us)) {
    devices_.io->notify_manager("WATCHDOG=1");
  }
  RunRecord::note_stuck(liveness_.stuck());
}

// Requests wait for the end of the frame before.
void Daemon::start(uint32_t number, FrameLease lease) {
  if (has_requests()) {
    turns_.wait_for_previous(*path_, number);
    swap_path();
  }
  const int32_t warmth = exchange_.milli_celsius;
  path_->set_temperature(warmth == kNoTemperature ? std::optional<int32_t>() : warmth);
  path_->set_capture_flags(lease.is_time_wrong() ? uint32_t{kFlagTime} : 0U);
  Flight& flight = flights_[number % 2];
  flight.start_us = devices_.clock.now_us();
  flight.frame = path_->begin(lease.view(), lease.capture_us());
  path_->enter(0, flight.frame);
  flight.lease.emplace(std::move(lease));
}

// `since_us`: when this thread took the frame.
void Daemon::finish(uint32_t number, uint64_t since_us) {
  const size_t n_segments = path_->n_segments();
  Flight& flight = flights_[number % 2];
  turns_.run(*path_, flight.frame, number, n_segments);
  const uint64_t start_us = devices_.clock.now_us();
  send_results(*flight.lease);
  if (network_ != nullptr) run_network(std::move(*flight.lease));
  flight.lease.reset();
  if (n_segments > 1) {
    flight.frame.segment_ns[n_segments - 1] += 1'000 * (devices_.clock.now_us() - start_us);
    cut_.record(flight.frame.segment_ns, n_segments);
  }
  govern_rate(std::max(flight.first_us, devices_.clock.now_us() - since_us));
  turns_.end(*path_, flight.frame);
}

void Daemon::send_results(const FrameLease& lease) {
  const FrameState& state = path_->state();
  switch_reflex(state);
  const FrameStamp stamp{lease.capture_us(), lease.number(), path_->calibration_id(), identity_.stream_flags};
  const uint64_t n = exchange_.frames_processed.load();
  const bool has_time = !options_.is_lockstep && !lease.is_time_wrong();
  exposed_us_ = has_time ? lease.capture_us() + static_cast<uint64_t>(board_.exposure.time_us) / 2 : 0;
  for (size_t type = 0; type < kMessageTypes; ++type) {
    const uint32_t every = exchange_.every[type].load(std::memory_order_relaxed);
    if (every == 0 || n % every != 0) continue;
    if (type == ruffini_MessageType_MESSAGE_TYPE_RESIDUAL) path_->compute_residual();
    encoder_.encode(static_cast<ruffini_MessageType>(type), *path_, lease.view(), stamp, sink_);
  }
  exposed_us_ = 0;
  for (size_t i = 0; i < kMaxRows; ++i) {
    const uint64_t ns = state.stage_ns[i];
    exchange_.stage_sum_ns[i].fetch_add(ns, std::memory_order_relaxed);
    if (ns > exchange_.stage_max_ns[i].load(std::memory_order_relaxed)) exchange_.stage_max_ns[i] = ns;
  }
  exchange_.flags = state.flags;
  uint32_t validity = 0;
  for (size_t i = 0; i < state.wrench.validity.size(); ++i) {
    validity |= static_cast<uint32_t>(state.wrench.validity[i]) << (4 * i);
  }
  exchange_.last_frame.capture_us = lease.capture_us();
  exchange_.last_frame.number = lease.number();
  exchange_.last_frame.calibration_id = path_->calibration_id();
  exchange_.last_frame.wrench_validity = validity;
  count(state.flags);
  exchange_.skin_light_1e3 = static_cast<uint32_t>(state.skin.age_q12 * 1'000 / SkinFrame::kOneQ12);
  exchange_.saturations = state.saturations.count;
  exchange_.is_touched = path_->is_touched();
  exchange_.is_zeroing = path_->is_zeroing();
  exchange_.refused_zeros = path_->rest_watch().n_refused;
  offer_rest();
  exchange_.zero_moved_nm = static_cast<uint32_t>(state.displacement.zero_moved_nm);
  exchange_.is_zero_at_limit = state.displacement.is_zero_at_limit;
  if (exchange_.is_camera_live) count_late(lease.capture_us());
  exchange_.frames_processed = n + 1;
  wake_link();  // now, so that the link thread also sees that the camera is back
}

// Copies an accepted rest image for the link thread. Asks for the room while the image is learned, so that it is there
// with the image's last frame: another frame may never come. Without it a later frame copies the image.
void Daemon::offer_rest() {
  if (!options_.save_rest) return;
  const uint32_t n_known = path_->rest_watch().n_accepted;
  const bool is_new = n_known != n_saved_rests_;
  const bool is_learning = !path_->has_rest();
  if ((is_new || is_learning) && rest_room_ == RestRoom::kNone) rest_room_ = RestRoom::kAsked;
  if (rest_room_ != RestRoom::kEmpty || (is_learning && !is_new)) return;
  if (is_new) {
    const std::span<const uint16_t> rest = path_->rest_image();
    std::copy(rest.begin(), rest.end(), rest_to_save_.begin());
    n_saved_rests_ = n_known;
  }
  rest_room_ = is_new ? RestRoom::kFull : RestRoom::kUnneeded;
}

void Daemon::save_rest() {
  const RestRoom room = rest_room_;
  if (room == RestRoom::kAsked) {
    rest_to_save_.resize(size_t{3} * static_cast<size_t>(board_.camera.width_px * board_.camera.height_px));
    rest_room_ = RestRoom::kEmpty;
  } else if (room == RestRoom::kFull || room == RestRoom::kUnneeded) {
    if (room == RestRoom::kFull) options_.save_rest(rest_to_save_);
    std::vector<uint16_t>().swap(rest_to_save_);
    rest_room_ = RestRoom::kNone;
  }
}

// One system call if the line changes, before anything is encoded.
void Daemon::switch_reflex(const FrameState& state) {
  const ReflexState before = exchange_.reflex;
  if (before == ReflexState::kNotConfigured || before == ReflexState::kFailed) return;
  const bool is_on = reflex_.update(state);
  if (is_on == (before == ReflexState::kOn)) return;
  const bool is_set = devices_.io->switch_reflex(is_on);
  exchange_.reflex = !is_set ? ReflexState::kFailed : is_on ? ReflexState::kOn : ReflexState::kOff;
  exchange_.reflex_trips += is_set && is_on ? 1U : 0U;
}

// One interval for each core and one more after capture, a newer frame is already waiting.
void Daemon::count_late(uint64_t capture_us) {
  const uint64_t interval_us =
      uint64_t{1'000'000'000} * exchange_.rate_divisor / static_cast<uint64_t>(board_.camera.rate_mhz);
  if (devices_.clock.now_us() > capture_us + static_cast<uint64_t>(1 + board_.n_cores) * interval_us)
    ++exchange_.missed_deadlines;
}

// Counts for the trial of a new calibration.
void Daemon::count(uint32_t flags) {
  PathTally tally = exchange_.tally;
  const bool is_good = (flags & kWrongFlags) == 0;
  if (tally.n_frames < UINT16_MAX) ++tally.n_frames;
  if (is_good && tally.n_good < UINT16_MAX) ++tally.n_good;
  exchange_.wrong_flags = exchange_.wrong_flags | (flags & kWrongFlags);
  exchange_.tally = tally;
}

// Frame thread: lends this frame to the network and sends its newest result; in lockstep, that of this frame.
void Daemon::run_network(FrameLease lease) {
  network_->post(std::move(lease), path_->state().flags, path_->calibration_id());
  if (options_.is_lockstep) network_->wait_idle();
  const LearnedResult* said = network_->take();
  const uint32_t every = exchange_.every[ruffini_MessageType_MESSAGE_TYPE_LEARNED].load(std::memory_order_relaxed);
  if (said == nullptr || every == 0 || n_network_results_++ % every != 0) return;
  encoder_.encode(*said, network_->names(), identity_.stream_flags, sink_);
  wake_link();
}

// Frame thread: lets the link thread write what was published, instead of at the end of its poll.
void Daemon::wake_link() {
  if (has_published_) devices_.link->wake();
  has_published_ = false;
}

// Frame thread: writes one message to the ring. Lockstep waits for room, live drops the message.
void Daemon::publish(ruffini_MessageType type, std::span<const uint8_t> frames) {
  has_published_ = true;
  while (!exchange_.push_telemetry({exposed_us_, static_cast<uint64_t>(type)}, frames)) {
    if (!options_.is_lockstep || is_stopping()) {
      ++exchange_.telemetry_dropped;
      return;
    }
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
}

void Daemon::link_loop() {
  begin("link");
  while (!stop_->load(std::memory_order_relaxed)) {
    if (!serve_once(kLinkPollMs)) {
      std::this_thread::sleep_for(kReopenPause);
      reopen_line();
    }
    if (has_sent_all() || !hardware_fault_.empty()) return;
  }
}

bool Daemon::serve_once(int wait_ms) {
  const uint64_t now_us = devices_.clock.now_us();
  if (now_us - board_health_us_ > kBoardHealthUs) {
    read_board_health();
    if (options_.hardware_fault && hardware_fault_.empty()) hardware_fault_ = options_.hardware_fault();
    board_health_us_ = now_us;
  }
  notify_manager(now_us);
  save_rest();
  session_.poll(now_us);
  std::span<const uint8_t> out = session_.pending();
  devices_.link->wait(!out.empty(), wait_ms);
  const int n_read = devices_.link->read(received_);
  if (n_read > 0) session_.receive({received_.data(), static_cast<size_t>(n_read)});
  int n_written = 0;
  for (; !out.empty(); out = session_.pending()) {
    n_written = devices_.link->write(out);
    if (n_written <= 0) break;
    session_.consumed(static_cast<size_t>(n_written));
    last_output_us_ = devices_.clock.now_us();
  }
  if (n_read >= 0 && n_written >= 0) return true;
  session_.reset_line();
  return false;
}

// True if a recording has ended and its results were read, or no reader remains.
bool Daemon::has_sent_all() {
  const uint64_t now_us = devices_.clock.now_us();
  if (!is_frame_over_ || options_.keeps_link_open) {
    last_output_us_ = last_pending_us_ = now_us;
    return false;
  }
  if (!session_.is_drained() || devices_.link->has_unsent()) last_pending_us_ = now_us;
  return now_us - last_pending_us_ > kQuietUs || now_us - last_output_us_ > kDrainUs;
}

}  // namespace ruffini
