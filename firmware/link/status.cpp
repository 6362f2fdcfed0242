// Messages about the device itself: HELLO, SCHEMA, STATUS.
#include <pb_encode.h>

#include <algorithm>
#include <cstring>
#include <iterator>
#include <sstream>

#include "core/stages.h"
#include "link/proto_text.h"
#include "link/session.h"
#include "schema.h"

namespace ruffini {

// Everything that the board parser accepts fits HELLO.
static_assert(pb_membersize(ruffini_SensorInfo, board_toml) > kMaxBoardBytes);
static_assert(pb_arraysize(ruffini_SensorInfo, not_measured) >= kMaxNotMeasured);
static_assert(pb_arraysize(ruffini_SensorInfo, stages) >= kMaxStages);
static_assert(pb_arraysize(ruffini_Status, stage_times) >= kMaxStages);
static_assert(pb_membersize(ruffini_SensorInfo, not_measured[0]) > kMaxListedLength);
static_assert(pb_membersize(ruffini_SensorInfo, stages[0]) > kMaxListedLength);
static_assert(pb_membersize(ruffini_Temperature, place) > kMaxListedLength);

namespace {

// Deviation from the calibration's light beyond which touches look different from the training data
constexpr uint32_t kAgedSkin1e3 = 250;

// If the tag does not fit, the value after it does not either, so the second result covers both.
bool write_schema(pb_ostream_t* stream, const pb_field_t* field, void* const*) {
  (void)pb_encode_tag_for_field(stream, field);
  return pb_encode_string(stream, kSchemaBytes, kSchemaSize);
}

// Position of a node relative to the pad's centre, nanometres: (2 i - (n - 1)) size / (2 (n - 1)).
int32_t origin_nm(int first, int n, int64_t size_um) {
  return static_cast<int32_t>(floor_div((2 * first - (n - 1)) * size_um * 1'000, 2 * int64_t{n - 1}));
}

}  // namespace

void Session::send_hello() {
  ruffini_Hello m = ruffini_Hello_init_zero;
  m.protocol_version = kProtocolVersion;
  std::memcpy(m.schema_sha256, kSchemaSha256, sizeof kSchemaSha256);
  copy_text(m.firmware_version, identity_.version);
  copy_text(m.device_serial, identity_.serial);
  m.session_id = identity_.session_id;
  m.needs_key = access_.needs_key();
  for (const std::string& id : calibrator_.keys().enrolled_ids()) {
    if (m.key_ids_count < std::size(m.key_ids)) copy_text(m.key_ids[m.key_ids_count++], id);
  }
  m.sensors_count = 1;
  ruffini_SensorInfo& s = m.sensors[0];
  s.sensor = identity_.sensor;
  copy_text(s.board, board_.name);
  copy_text(s.product, board_.product);
  s.image_width_px = static_cast<uint32_t>(board_.camera.width_px);
  s.image_height_px = static_cast<uint32_t>(board_.camera.height_px);
  s.grid_n_x = static_cast<uint32_t>(grid_.n_x);
  s.grid_n_y = static_cast<uint32_t>(grid_.n_y);
  s.grid_origin_x_nm = origin_nm(first_x_.first, board_.grid.n_x, board_.pad.size_x_um);
  s.grid_origin_y_nm = origin_nm(first_y_.first, board_.grid.n_y, board_.pad.size_y_um);
  s.grid_step_x_nm = static_cast<uint32_t>(floor_div(board_.pad.size_x_um * 1'000, board_.grid.n_x - 1));
  s.grid_step_y_nm = static_cast<uint32_t>(floor_div(board_.pad.size_y_um * 1'000, board_.grid.n_y - 1));
  s.n_markers = static_cast<uint32_t>(board_.markers.lattice.count());
  for (const std::string& stage : board_.stages) copy_text(s.stages[s.stages_count++], stage);
  for (const std::string& what : board_.not_measured) copy_text(s.not_measured[s.not_measured_count++], what);
  copy_text(s.board_toml, board_.toml);
  const ActiveCalibration& active = calibrator_.active();
  s.has_calibration = true;
  s.calibration.present = active.is_present;
  if (active.is_present) {
    copy_bytes(s.calibration.sha256, active.sha256);
    copy_text(s.calibration.created_utc, active.created_utc);
    copy_text(s.calibration.key_id, active.signer.key_id);
    copy_text(s.calibration.summary, to_plain_ascii(active.gates));
    s.calibration.development_key = active.signer.is_development_key;
    s.calibration.on_trial = calibrator_.is_on_trial();
    std::stringstream kinds(active.kinds);
    for (std::string kind;
         s.calibration.kinds_count < std::size(s.calibration.kinds) && std::getline(kinds, kind, ',');)
      copy_text(s.calibration.kinds[s.calibration.kinds_count++], kind);
  }
  send(ruffini_MessageType_MESSAGE_TYPE_HELLO, ruffini_Hello_fields, &m);
}

void Session::send_schema() {
  ruffini_Schema m = ruffini_Schema_init_zero;
  m.file_descriptor_set.funcs.encode = write_schema;
  copy_bytes(m.sha256, std::string(reinterpret_cast<const char*>(kSchemaSha256), sizeof kSchemaSha256));
  send(ruffini_MessageType_MESSAGE_TYPE_SCHEMA, ruffini_Schema_fields, &m);
}

void Session::send_stale_wrench() {
  if (exchange_.frames_processed == 0) return;  // no frame yet
  ruffini_Wrench m = ruffini_Wrench_init_zero;
  m.has_stamp = true;
  m.stamp.capture_us = exchange_.last_frame.capture_us;
  m.stamp.frame = exchange_.last_frame.number;
  m.stamp.flags = exchange_.flags | ruffini_FlagBit_FLAG_STALE;
  m.stamp.calibration_id = exchange_.last_frame.calibration_id;
  m.validity_count = 6;
  const uint32_t was = exchange_.last_frame.wrench_validity;
  for (size_t i = 0; i < 6; ++i) {
    const bool is_measured = (was >> (4 * i) & 15) != ruffini_Validity_VALIDITY_NOT_MEASURED;
    m.validity[i] = is_measured ? ruffini_Validity_VALIDITY_INVALID : ruffini_Validity_VALIDITY_NOT_MEASURED;
  }
  // Sent as telemetry, not as a reply, so that a host that does not read gets the newest.
  Outgoing& slot = newest(ruffini_MessageType_MESSAGE_TYPE_WRENCH);
  slot.bytes = serialize_message(ruffini_Wrench_fields, &m);
  slot.needs_framing = true;
}

void Session::send_event(uint64_t now_us, ruffini_Event_Severity severity, const char* what, const std::string& text) {
  ruffini_Event m = ruffini_Event_init_zero;
  m.time_us = now_us;
  m.severity = severity;
  copy_text(m.what, what);
  copy_text(m.text, text);
  send(ruffini_MessageType_MESSAGE_TYPE_EVENT, ruffini_Event_fields, &m);
}

// State of the learned network, if the board has one.
void Session::report_network(ruffini_Status& m) const {
  const NetworkHealth& network = exchange_.network;
  if (!network.is_asked) return;
  const NetworkState state = network.state.load(std::memory_order_acquire);
  m.has_network = true;
  m.network.state = static_cast<ruffini_NetworkState>(state);
  m.network.results = network.results;
  m.network.invalid = network.invalid;
  m.network.skipped = network.skipped;
  m.network.took_us = network.took_us;
  m.network.latency_us = network.latency_us;
  m.network.period_us = network.period_us;
  if (state == NetworkState::kRuns) copy_bytes(m.network.sha256, {network.sha256.begin(), network.sha256.end()});
  if (state != NetworkState::kFailed) return;
  copy_text(m.network.problem, network.problem.data());
  m.health |= ruffini_HealthBit_HEALTH_NETWORK;
}

void Session::report_last_run(ruffini_Status& m) const {
  if (!identity_.last_run) return;
  const LastRun& last = *identity_.last_run;
  m.has_last_run = true;
  m.last_run.end = static_cast<ruffini_RunEnd>(last.end);
  m.last_run.signal = last.signal;
  copy_text(m.last_run.thread, last.thread);
  copy_text(m.last_run.stuck, last.stuck);
  m.last_run.uptime_us = last.uptime_us;
  copy_bytes(m.last_run.calibration_id, last.calibration_id);
  m.last_run.crashes = last.crashes;
  if (last.end == RunEnd::kCrashed) m.health |= ruffini_HealthBit_HEALTH_CRASHED;
  if (identity_.is_safe_mode) m.health |= ruffini_HealthBit_HEALTH_SAFE_MODE;
}

// Camera, computer, creep and reflex. `n_frames`: since the last status.
void Session::report_health(ruffini_Status& m, uint64_t n_frames) {
  m.camera_gaps = exchange_.frames_missed;
  m.repeated_frames = exchange_.frames_repeated;
  m.time_faults = exchange_.time_faults;
  m.missed_deadlines = exchange_.missed_deadlines;
  if ((m.missed_deadlines - status_late_) * 100 > n_frames) m.health |= ruffini_HealthBit_HEALTH_LATE;
  status_late_ = m.missed_deadlines;
  m.throttled = exchange_.throttled;
  m.rate_divisor = exchange_.rate_divisor;
  m.frames_left_out = exchange_.frames_left_out;
  if (m.rate_divisor != 1) m.health |= ruffini_HealthBit_HEALTH_RATE;
  if ((m.throttled & kThrottledNow) != 0) m.health |= ruffini_HealthBit_HEALTH_THROTTLED;
  if (exchange_.has_light_fault) m.health |= ruffini_HealthBit_HEALTH_LIGHT;
  m.zero_moved_nm = exchange_.zero_moved_nm;
  if (exchange_.is_zero_at_limit) m.health |= ruffini_HealthBit_HEALTH_ZERO_LIMIT;
  m.reflex = static_cast<ruffini_ReflexState>(exchange_.reflex.load());
  m.reflex_trips = exchange_.reflex_trips;
  if (exchange_.reflex == ReflexState::kFailed) m.health |= ruffini_HealthBit_HEALTH_REFLEX;
}

// Latency of the line, and what other work on this computer can delay.
void Session::report_latency(ruffini_Status& m) const {
  m.has_line_latency = true;
  m.line_latency.n_frames = latency_.n_frames();
  m.line_latency.p50_us = latency_.percentile_us(500);
  m.line_latency.p99_us = latency_.percentile_us(990);
  m.line_latency.p999_us = latency_.percentile_us(999);
  m.line_latency.max_us = latency_.max_us();
  m.has_scheduling = true;
  m.scheduling.priority = exchange_.frame_priority;
  m.scheduling.cpus = exchange_.frame_cpus;
  m.scheduling.is_memory_locked = identity_.is_memory_locked;
}

void Session::send_status(uint64_t now_us) {
  ruffini_Status m = ruffini_Status_init_zero;
  const uint64_t frames = exchange_.frames_processed.load();
  const uint64_t elapsed_us = std::max<uint64_t>(now_us - status_us_, 1);
  m.uptime_us = now_us - started_us_;
  m.frame_rate_mhz =
      status_us_ == 0 ? 0 : static_cast<uint32_t>((frames - status_frames_) * 1'000'000'000 / elapsed_us);
  m.link_bytes_per_s =
      status_us_ == 0 ? 0 : static_cast<uint32_t>((bytes_sent_ - status_bytes_) * 1'000'000 / elapsed_us);
  m.frames_captured = exchange_.frames_captured.load();
  m.frames_processed = frames;
  m.has_drops = true;
  m.drops = {.capture_overrun = exchange_.frames_overrun.load(),
             .link_backpressure = exchange_.telemetry_dropped.load() + n_unsent_,
             .invalid_frame = exchange_.frames_invalid.load(),
             .rx_bad_crc = decoder_.counters().bad_crc,
             .rx_malformed = decoder_.counters().malformed + rx_malformed_,
             .rx_oversize = decoder_.counters().oversize,
             .rx_echo = rx_echo_,
             .link_replaced = n_replaced_,
             .link_ring_full = exchange_.telemetry_dropped.load() - n_replaced_ + n_unsent_,
             .link_down = n_dropped_on_hang_up_,
             .link_cut = n_truncated_};
  m.has_access = true;
  m.access.is_open = !access_.needs_key();
  m.access.n_refused = access_.n_refused();
  copy_text(m.access.holder, access_.holder());
  copy_text(m.store_problem, calibrator_.problem());
  m.saturations = exchange_.saturations.load();
  const uint64_t n = std::max<uint64_t>(frames - status_frames_, 1);
  for (const std::string& name : board_.stages) {
    const size_t i = stage_row(name);
    ruffini_StageTime& t = m.stage_times[m.stage_times_count++];
    copy_text(t.stage, name);
    t.mean_ns = static_cast<uint32_t>(exchange_.stage_sum_ns[i].exchange(0) / n);
    t.max_ns = static_cast<uint32_t>(exchange_.stage_max_ns[i].exchange(0));
  }
  if (const int32_t warmth = exchange_.milli_celsius.load(); warmth != kNoTemperature) {
    m.temperatures_count = 1;
    copy_text(m.temperatures[0].place, board_.temperature.place);
    m.temperatures[0].milli_celsius = warmth;
  }
  const ActiveCalibration& active = calibrator_.active();
  if (!active.is_present) m.health |= ruffini_HealthBit_HEALTH_UNCALIBRATED;
  if (active.lacks_passed_gates()) m.health |= ruffini_HealthBit_HEALTH_UNJUDGED;
  if (calibrator_.keys().accepts_development_key()) m.health |= ruffini_HealthBit_HEALTH_DEVELOPMENT_KEY;
  if ((exchange_.flags.load() & kFlagNoReference) != 0) m.health |= ruffini_HealthBit_HEALTH_NO_REFERENCE;
  if (is_stalled_) m.health |= ruffini_HealthBit_HEALTH_CAMERA_STALLED;
  if (calibrator_.is_on_trial()) m.health |= ruffini_HealthBit_HEALTH_TRIAL;
  if (!calibrator_.problem().empty()) m.health |= ruffini_HealthBit_HEALTH_STORE_ERROR;
  m.skin_light_1e3 = exchange_.skin_light_1e3.load();
  const bool has_aged = m.skin_light_1e3 < 1'000 - kAgedSkin1e3 || m.skin_light_1e3 > 1'000 + kAgedSkin1e3;
  if (m.skin_light_1e3 != 0 && has_aged) m.health |= ruffini_HealthBit_HEALTH_SKIN_AGED;
  if (decoder_.counters().bad_crc > 0) m.health |= ruffini_HealthBit_HEALTH_LINK_DEGRADED;
  report_network(m);
  report_last_run(m);
  report_health(m, n);
  report_latency(m);
  m.development_key = active.is_present && active.signer.is_development_key;
  copy_bytes(m.calibration_sha256, active.sha256);
  status_us_ = now_us;
  status_frames_ = frames;
  status_bytes_ = bytes_sent_;
  send(ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_Status_fields, &m);
}

}  // namespace ruffini
