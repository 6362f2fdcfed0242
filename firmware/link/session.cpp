#include "link/session.h"

#include <pb_decode.h>
#include <pb_encode.h>

#include <algorithm>
#include <cstring>
#include <iterator>
#include <sstream>

#include "link/messages.h"
#include "schema.h"

namespace ruffini {

// Every type has its slot, and what the board's parser lets through fits HELLO.
static_assert(_ruffini_MessageType_MAX < kMessageTypes);
static_assert(sizeof ruffini_SensorInfo::board_toml > kMaxBoardBytes);
static_assert(std::size(decltype(ruffini_SensorInfo::not_measured){}) >= kMaxNotMeasured);
static_assert(std::size(decltype(ruffini_SensorInfo::stages){}) >= kStageCount);
static_assert(sizeof ruffini_SensorInfo::not_measured[0] > kMaxListedLength);
static_assert(sizeof ruffini_SensorInfo::stages[0] > kMaxListedLength);

namespace {

constexpr uint64_t kStatusPeriodUs = 1'000'000;
constexpr size_t kMaxReplies = 64;  // a host that asks faster than it reads is not answered

// What does not fit is cut off, before a whole UTF-8 character: half a one would spoil the message.
template <size_t N>
void copy_text(char (&out)[N], const std::string& text) {
  size_t n = std::min(text.size(), N - 1);
  while (n > 0 && n < text.size() && (static_cast<uint8_t>(text[n]) & 0xC0) == 0x80) --n;
  std::memcpy(out, text.data(), n);
  out[n] = '\0';
}

// What came over the line, fit to be said: a text that is no UTF-8 would spoil the reply.
std::string plain(std::string text) {
  std::replace_if(text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return text;
}

template <typename Bytes>
void copy_bytes(Bytes& out, const std::string& bytes) {
  out.size = static_cast<pb_size_t>(std::min(bytes.size(), sizeof out.bytes));
  std::memcpy(out.bytes, bytes.data(), out.size);
}

bool write_schema(pb_ostream_t* stream, const pb_field_t* field, void* const*) {
  return pb_encode_tag_for_field(stream, field) && pb_encode_string(stream, kSchemaBytes, kSchemaSize);
}

ruffini_ReplyCode code_of(ErrorKind kind) {
  switch (kind) {
    case ErrorKind::kBadInput:
      return ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
    case ErrorKind::kUnavailable:
      return ruffini_ReplyCode_REPLY_NOT_READY;
    case ErrorKind::kRefused:
      return ruffini_ReplyCode_REPLY_REFUSED;
    case ErrorKind::kStorage:
      return ruffini_ReplyCode_REPLY_STORAGE;
  }
  return ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
}

void answer(ruffini_Reply& reply, const Status& status) {
  if (status) return;
  reply.code = code_of(status.error().kind);
  copy_text(reply.text, status.error().message);
}

// Node position from the pad's centre, nanometres: (2 i - (n - 1)) size / (2 (n - 1)).
int32_t origin_nm(int first, int n, int64_t size_um) {
  return static_cast<int32_t>(floor_div((2 * first - (n - 1)) * size_um * 1'000, 2 * int64_t{n - 1}));
}

}  // namespace

Session::Session(const BoardSettings& board, const FramePath& path, DeviceIdentity identity, Calibrator& calibrator,
                 Exchange& exchange)
    : board_(board),
      identity_(std::move(identity)),
      calibrator_(calibrator),
      exchange_(exchange),
      grid_(path.nodes().size()),
      first_x_(observed_nodes(board.grid.n_x, board.pad.size_x_um, board.window.min_x_um, board.window.max_x_um)),
      first_y_(observed_nodes(board.grid.n_y, board.pad.size_y_um, board.window.min_y_um, board.window.max_y_um)) {}

void Session::receive(std::span<const uint8_t> bytes) {
  for (const uint8_t byte : bytes) {
    if (const std::optional<WireFrame> frame = decoder_.push(byte)) handle(*frame);
  }
}

void Session::handle(const WireFrame& frame) {
  if ((frame.header.flags & kFromHost) == 0) {
    ++rx_echo_;  // our own frame: somebody's terminal echoes
    return;
  }
  if (frame.header.n_fragments != 1) {
    ++rx_malformed_;  // no host message needs more than one frame
    return;
  }
  switch (frame.header.type) {
    case ruffini_MessageType_MESSAGE_TYPE_HELLO:
      has_last_reply_ = false;  // a host that starts may count its requests from any number
      send_hello();
      return;
    case ruffini_MessageType_MESSAGE_TYPE_SCHEMA:
      send_schema();
      return;
    case ruffini_MessageType_MESSAGE_TYPE_STATUS:
      is_status_asked_ = true;
      return;
    case ruffini_MessageType_MESSAGE_TYPE_COMMAND:
      break;
    default:
      return;  // a type of the future
  }
  ruffini_Command message = ruffini_Command_init_zero;
  pb_istream_t stream = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  if (!pb_decode(&stream, ruffini_Command_fields, &message)) {
    ++rx_malformed_;
    return;
  }
  command(message, frame.header.sensor);
}

void Session::command(const ruffini_Command& request, uint8_t sensor) {
  if (has_last_reply_ && request.request_id == last_request_id_) {  // a retry: answered, not run again
    send(ruffini_MessageType_MESSAGE_TYPE_REPLY, ruffini_Reply_fields, &last_reply_);
    return;
  }
  ruffini_Reply reply = ruffini_Reply_init_zero;
  reply.request_id = request.request_id;
  if (sensor == kDeviceSensor || sensor == identity_.sensor) {
    act(request, reply);
  } else {
    reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
    copy_text(reply.text, "no sensor " + std::to_string(sensor) + " here: HELLO lists those there are");
  }
  last_request_id_ = request.request_id;
  last_reply_ = reply;
  has_last_reply_ = true;
  send(ruffini_MessageType_MESSAGE_TYPE_REPLY, ruffini_Reply_fields, &reply);
}

void Session::act(const ruffini_Command& request, ruffini_Reply& reply) {
  switch (request.which_action) {
    case ruffini_Command_subscribe_tag:
      subscribe(request.action.subscribe);
      break;
    case ruffini_Command_zero_tag:
      if (request.action.zero.n_frames > 256) {
        reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
        copy_text(reply.text, "zero takes 0 to 256 frames");
      } else {
        exchange_.zero_frames = static_cast<int>(request.action.zero.n_frames);
      }
      break;
    case ruffini_Command_flash_begin_tag:
    case ruffini_Command_flash_chunk_tag:
    case ruffini_Command_flash_commit_tag:
    case ruffini_Command_flash_abort_tag:
      flash(request, reply);
      break;
    case ruffini_Command_get_tag:
    case ruffini_Command_set_tag: {
      const bool is_get = request.which_action == ruffini_Command_get_tag;
      const char* key = is_get ? request.action.get.key : request.action.set.key;
      reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
      if (is_get && std::strcmp(key, "frames_processed") == 0) {
        reply.code = ruffini_ReplyCode_REPLY_OK;
        reply.value = static_cast<int64_t>(exchange_.frames_processed.load());
      } else {
        copy_text(reply.text, "no setting \"" + plain(key) + "\": this firmware has frames_processed (get)");
      }
      break;
    }
    default:
      reply.code = ruffini_ReplyCode_REPLY_UNKNOWN_COMMAND;
      copy_text(reply.text, "unknown command: the host tool is newer than this firmware");
  }
}

void Session::flash(const ruffini_Command& request, ruffini_Reply& reply) {
  switch (request.which_action) {
    case ruffini_Command_flash_begin_tag: {
      const ruffini_FlashBegin& begin = request.action.flash_begin;
      answer(reply, calibrator_.begin(begin.size_bytes,
                                      {reinterpret_cast<const char*>(begin.sha256.bytes), begin.sha256.size}));
      break;
    }
    case ruffini_Command_flash_chunk_tag: {
      const ruffini_FlashChunk& chunk = request.action.flash_chunk;
      answer(reply, calibrator_.chunk(chunk.offset, {chunk.data.bytes, chunk.data.size}));
      break;
    }
    case ruffini_Command_flash_commit_tag: {
      const Status committed = calibrator_.commit();
      answer(reply, committed);
      if (committed) {
        reply.flash_state = ruffini_FlashState_FLASH_STATE_ACTIVE;
        return;
      }
      break;
    }
    default:
      calibrator_.abort();
  }
  reply.next_offset = calibrator_.next_offset();
  reply.flash_state = calibrator_.is_complete()    ? ruffini_FlashState_FLASH_STATE_RECEIVED
                      : calibrator_.is_receiving() ? ruffini_FlashState_FLASH_STATE_RECEIVING
                                                   : ruffini_FlashState_FLASH_STATE_IDLE;
}

void Session::subscribe(const ruffini_Subscribe& request) {
  for (auto& every : exchange_.every) every = 0;
  for (pb_size_t i = 0; i < request.subscriptions_count; ++i) {
    const ruffini_Subscription& s = request.subscriptions[i];
    uint32_t type = 0;  // what the wire says may be none of the enum's values
    static_assert(sizeof type == sizeof s.type);
    std::memcpy(&type, &s.type, sizeof type);
    if (type > 0 && type < kMessageTypes) exchange_.every[type] = s.every;
  }
}

void Session::send(ruffini_MessageType type, const pb_msgdesc_t* fields, const void* message) {
  if (replies_.size() >= kMaxReplies) return;
  size_t n_bytes = 0;
  if (!pb_get_encoded_size(&n_bytes, fields, message)) return;
  std::vector<uint8_t> payload(n_bytes);
  pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
  if (!pb_encode(&stream, fields, message)) return;
  std::vector<uint8_t> frames(frames_bound(n_bytes));
  frames.resize(write_frames(type, identity_.stream_flags, kDeviceSensor, sequence_++, payload, frames));
  replies_.push_back(std::move(frames));
}

void Session::send_hello() {
  ruffini_Hello m = ruffini_Hello_init_zero;
  m.protocol_version = kProtocolVersion;
  std::memcpy(m.schema_sha256, kSchemaSha256, sizeof kSchemaSha256);
  copy_text(m.firmware_version, identity_.version);
  copy_text(m.device_serial, identity_.serial);
  m.session_id = identity_.session_id;
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
    s.calibration.development_key = active.signer.is_development_key;
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
             .link_backpressure = exchange_.telemetry_dropped.load(),
             .invalid_frame = exchange_.frames_invalid.load(),
             .rx_bad_crc = decoder_.counters().bad_crc,
             .rx_malformed = decoder_.counters().malformed + rx_malformed_,
             .rx_oversize = decoder_.counters().oversize,
             .rx_echo = rx_echo_};
  m.saturations = exchange_.saturations.load();
  const uint64_t n = std::max<uint64_t>(frames - status_frames_, 1);
  for (size_t i = 0; i < kStageCount; ++i) {
    ruffini_StageTime& t = m.stage_times[m.stage_times_count++];
    copy_text(t.stage, known_stages()[i]);
    t.mean_ns = static_cast<uint32_t>(exchange_.stage_sum_ns[i].exchange(0) / n);
    t.max_ns = static_cast<uint32_t>(exchange_.stage_max_ns[i].exchange(0));
  }
  const ActiveCalibration& active = calibrator_.active();
  if (!active.is_present) m.health |= ruffini_HealthBit_HEALTH_UNCALIBRATED;
  if (active.is_present && active.signer.is_development_key) m.health |= ruffini_HealthBit_HEALTH_DEVELOPMENT_KEY;
  if ((exchange_.flags.load() & kFlagNoReference) != 0) m.health |= ruffini_HealthBit_HEALTH_NO_REFERENCE;
  if (decoder_.counters().bad_crc > 0) m.health |= ruffini_HealthBit_HEALTH_LINK_DEGRADED;
  m.development_key = active.is_present && active.signer.is_development_key;
  copy_bytes(m.calibration_sha256, active.sha256);
  status_us_ = now_us;
  status_frames_ = frames;
  status_bytes_ = bytes_sent_;
  send(ruffini_MessageType_MESSAGE_TYPE_STATUS, ruffini_Status_fields, &m);
}

void Session::take_telemetry() {
  // Lossless: leave messages in the ring until their slot is free, so that the frame thread waits.
  if (identity_.is_lossless &&
      std::any_of(telemetry_.begin(), telemetry_.end(), [](const Outgoing& o) { return o.is_full; })) {
    return;
  }
  while (exchange_.telemetry.pop(popped_)) {
    Outgoing& slot = telemetry_[popped_[0] % kMessageTypes];
    if (slot.is_full) exchange_.telemetry_dropped.fetch_add(1, std::memory_order_relaxed);
    slot.bytes.assign(popped_.begin() + 1, popped_.end());
    slot.is_full = true;
    slot.order = order_++;
    if (identity_.is_lossless) return;
  }
}

void Session::poll(uint64_t now_us) {
  if (started_us_ == 0) started_us_ = now_us;
  delete exchange_.retired_path.exchange(nullptr, std::memory_order_acq_rel);
  const bool is_subscribed = exchange_.every[ruffini_MessageType_MESSAGE_TYPE_STATUS] != 0;
  const bool is_due = status_us_ == 0 || now_us - status_us_ >= kStatusPeriodUs;
  if (is_status_asked_ || (is_subscribed && is_due)) send_status(now_us);
  is_status_asked_ = false;
  take_telemetry();
}

std::span<const uint8_t> Session::pending() {
  if (written_ == writing_.size()) {
    written_ = 0;
    writing_.clear();
    if (!replies_.empty()) {
      writing_.swap(replies_.front());
      replies_.pop_front();
    } else {
      Outgoing* next = nullptr;
      for (Outgoing& slot : telemetry_) {
        if (slot.is_full && (next == nullptr || slot.order < next->order)) next = &slot;
      }
      if (next != nullptr) {
        writing_.swap(next->bytes);
        next->is_full = false;
      }
    }
  }
  return std::span<const uint8_t>(writing_).subspan(written_);
}

void Session::consumed(size_t n_bytes) {
  written_ += n_bytes;
  bytes_sent_ += n_bytes;
}

void Session::reset_line() {
  written_ = 0;
  writing_.clear();
  replies_.clear();
  for (auto& every : exchange_.every) every = 0;
  while (exchange_.telemetry.pop(popped_)) continue;
  for (Outgoing& slot : telemetry_) slot.is_full = false;
  has_last_reply_ = false;
}

bool Session::is_drained() {
  take_telemetry();
  return pending().empty();
}

}  // namespace ruffini
