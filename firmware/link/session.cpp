#include "link/session.h"

#include <pb_decode.h>
#include <pb_encode.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "link/messages.h"
#include "link/proto_text.h"
#include "link/reply.h"

namespace ruffini {

static_assert(_ruffini_MessageType_MAX < kMessageTypes, "every type has its slot");

namespace {

constexpr uint64_t kStatusPeriodUs = 1'000'000;
constexpr uint64_t kSyncAgainUs = 1'000'000;
constexpr uint64_t kStalePeriodUs = 100'000;
// The person who zeroes keeps off for this long beyond the frames that it needs
constexpr uint64_t kHandsOffUs = 500'000;
constexpr size_t kMaxReplies = 64;  // a host that sends faster than it reads gets no reply

}  // namespace

Session::Session(const BoardSettings& board, const FramePath& path, DeviceIdentity identity, Calibrator& calibrator,
                 Exchange& exchange, const SessionSeams& seams)
    : board_(board),
      identity_(std::move(identity)),
      calibrator_(calibrator),
      exchange_(exchange),
      clock_(seams.clock),
      access_(calibrator.keys(), identity_.serial, seams),
      grid_(path.nodes().size()),
      first_x_(observed_nodes(board.grid.n_x, board.pad.size_x_um, board.window.min_x_um, board.window.max_x_um)),
      first_y_(observed_nodes(board.grid.n_y, board.pad.size_y_um, board.window.min_y_um, board.window.max_y_um)),
      stall_(1'000'000'000 / static_cast<uint64_t>(board.camera.rate_mhz)) {}

void Session::receive(std::span<const uint8_t> bytes) {
  const uint64_t n_before = n_damaged();
  received_us_ = clock_.now_us();
  for (const uint8_t byte : bytes) {
    if (const std::optional<WireFrame> frame = decoder_.push(byte)) handle(*frame);
  }
  if (n_damaged() != n_before && calibrator_.is_receiving() && !has_requested_retransmission_) request_retransmission();
}

uint64_t Session::n_damaged() const {
  const DecoderCounters& counters = decoder_.counters();
  return counters.bad_crc + counters.malformed + counters.oversize;
}

// A damaged chunk arrived: tells the host at once, instead of letting it time out. At most once until an intact command
// arrives, because on a line that echoes and damages bytes the device would answer itself forever.
void Session::request_retransmission() {
  has_requested_retransmission_ = true;
  ruffini_Reply reply = ruffini_Reply_init_zero;
  reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
  reply.next_offset = calibrator_.next_offset();
  copy_text(reply.text, "a frame came damaged: send it again");
  send(ruffini_MessageType_MESSAGE_TYPE_REPLY, ruffini_Reply_fields, &reply);
}

void Session::handle(const WireFrame& frame) {
  if ((frame.header.flags & kFromHost) == 0) {
    ++rx_echo_;  // one of our own frames: a terminal echoes
    return;
  }
  if (frame.header.n_fragments != 1) {
    ++rx_malformed_;  // host messages never need more than one frame
    return;
  }
  switch (frame.header.type) {
    case ruffini_MessageType_MESSAGE_TYPE_HELLO:
      if (last_holder_ == 0) has_last_reply_ = false;  // a new host may start its request numbers anywhere
      send_hello();
      return;
    case ruffini_MessageType_MESSAGE_TYPE_SCHEMA:
      send_schema();
      return;
    case ruffini_MessageType_MESSAGE_TYPE_STATUS:
      is_status_requested_ = true;
      return;
    case ruffini_MessageType_MESSAGE_TYPE_TIME:
      answer_time(frame);
      return;
    case ruffini_MessageType_MESSAGE_TYPE_SIGNED_COMMAND:
      signed_command(frame);
      return;
    case ruffini_MessageType_MESSAGE_TYPE_COMMAND:
      break;
    default:
      return;  // a message type of a later version
  }
  ruffini_Command message = ruffini_Command_init_zero;
  pb_istream_t stream = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  if (!pb_decode(&stream, ruffini_Command_fields, &message)) {
    ++rx_malformed_;
    return;
  }
  command(message, frame.header.sensor, authorize(message, false));
}

// `allowed`: whether the command is permitted.
void Session::command(const ruffini_Command& request, uint8_t sensor, const Status& allowed) {
  has_requested_retransmission_ = false;
  if (is_repeat(request)) {  // a retry: repeat the reply, do not execute again
    send(ruffini_MessageType_MESSAGE_TYPE_REPLY, ruffini_Reply_fields, &last_reply_);
    return;
  }
  ruffini_Reply reply = ruffini_Reply_init_zero;
  reply.request_id = request.request_id;
  if (sensor != kDeviceSensor && sensor != identity_.sensor) {
    reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
    copy_text(reply.text, "no sensor " + std::to_string(sensor) + " here: HELLO lists those there are");
  } else if (!allowed) {
    fill_reply(reply, allowed);
  } else {
    execute(request, reply);
  }
  access_.renew(request.holder);
  if (allowed && is_remembered(request)) {
    last_request_id_ = request.request_id;
    last_holder_ = request.holder;
    last_reply_ = reply;
    has_last_reply_ = true;
  }
  send(ruffini_MessageType_MESSAGE_TYPE_REPLY, ruffini_Reply_fields, &reply);
}

void Session::execute(const ruffini_Command& request, ruffini_Reply& reply) {
  switch (request.which_action) {
    case ruffini_Command_subscribe_tag:
      subscribe(request.action.subscribe);
      break;
    case ruffini_Command_zero_tag:
      if (request.action.zero.n_frames > 256) {
        reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
        copy_text(reply.text, "zero takes 0 to 256 frames");
      } else if (is_stalled_) {
        reply.code = ruffini_ReplyCode_REPLY_NOT_READY;
        copy_text(reply.text, "the camera stands still: what rest would be learned from cannot be seen");
      } else if (exchange_.is_touched && !request.action.zero.even_if_touched) {
        reply.code = ruffini_ReplyCode_REPLY_REFUSED;
        copy_text(reply.text,
                  "something presses on the pad: take it away and zero again, or say that it is to be part of rest");
      } else {
        exchange_.zero_even_if_touched = request.action.zero.even_if_touched;
        exchange_.zero_frames = static_cast<int>(request.action.zero.n_frames);
      }
      break;
    case ruffini_Command_flash_begin_tag:
    case ruffini_Command_flash_chunk_tag:
    case ruffini_Command_flash_commit_tag:
    case ruffini_Command_flash_abort_tag:
    case ruffini_Command_flash_undo_tag:
    case ruffini_Command_flash_query_tag:
      flash(request, reply);
      break;
    case ruffini_Command_flash_read_tag:
      read_back(request.action.flash_read, reply);
      break;
    case ruffini_Command_challenge_tag:
    case ruffini_Command_lease_tag:
      lease(request, reply);
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
        copy_text(reply.text, "no setting \"" + to_plain_ascii(key) + "\": this firmware has frames_processed (get)");
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
      if ((exchange_.throttled & kUndervoltageNow) != 0) {
        reply.code = ruffini_ReplyCode_REPLY_REFUSED;
        copy_text(reply.text,
                  "the computer is short of power (under-voltage): no flash is begun; give it a stronger supply or a "
                  "shorter cable, then flash again");
        break;
      }
      fill_reply(reply, calibrator_.begin(begin.size_bytes,
                                          {reinterpret_cast<const char*>(begin.sha256.bytes), begin.sha256.size}));
      break;
    }
    case ruffini_Command_flash_chunk_tag: {
      const ruffini_FlashChunk& chunk = request.action.flash_chunk;
      fill_reply(reply, calibrator_.chunk(chunk.offset, {chunk.data.bytes, chunk.data.size}));
      break;
    }
    case ruffini_Command_flash_undo_tag:
    case ruffini_Command_flash_commit_tag: {
      const bool is_undo = request.which_action == ruffini_Command_flash_undo_tag;
      const Status done = is_undo ? calibrator_.undo() : calibrator_.commit();
      fill_reply(reply, done);
      if (done) {
        report_trial(reply);
        return;
      }
      break;
    }
    case ruffini_Command_flash_query_tag: {
      const auto& wanted = request.action.flash_query.sha256;
      const std::string& active = calibrator_.active().sha256;  // empty: no calibration is in force
      if (!active.empty() && active.size() == wanted.size &&
          std::memcmp(active.data(), wanted.bytes, wanted.size) == 0) {
        report_trial(reply);
        return;
      }
      reply.code = ruffini_ReplyCode_REPLY_REFUSED;
      copy_text(reply.text, calibrator_.problem().empty() ? "this calibration is not in force" : calibrator_.problem());
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

// Reports the state of the trial.
void Session::report_trial(ruffini_Reply& reply) const {
  if (!calibrator_.is_on_trial()) {
    reply.flash_state = ruffini_FlashState_FLASH_STATE_ACTIVE;
    if (!calibrator_.is_durable()) reply.code = ruffini_ReplyCode_REPLY_STORAGE;
    copy_text(reply.text, calibrator_.problem());
    return;
  }
  const PathTally tally = calibrator_.tally();
  reply.flash_state = ruffini_FlashState_FLASH_STATE_DURABLE;
  reply.value = tally.n_frames;
  copy_text(reply.text, "on trial: " + std::to_string(tally.n_good) + " of " +
                            std::to_string(calibrator_.rule().n_good) + " good frames, of " +
                            std::to_string(tally.n_frames));
}

void Session::subscribe(const ruffini_Subscribe& request) {
  latency_.reset();
  for (auto& every : exchange_.every) every = 0;
  for (pb_size_t i = 0; i < request.subscriptions_count; ++i) {
    const ruffini_Subscription& s = request.subscriptions[i];
    uint32_t type = 0;  // the value on the wire may be outside the enum
    static_assert(sizeof type == sizeof s.type);
    std::memcpy(&type, &s.type, sizeof type);
    if (type > 0 && type < kMessageTypes) exchange_.every[type] = s.every;
  }
}

void Session::send(ruffini_MessageType type, const pb_msgdesc_t* fields, const void* message) {
  if (replies_.size() >= kMaxReplies) {  // its number is missing then
    ++sequence_;
    ++n_unsent_;
    return;
  }
  replies_.push_back({type, serialize_message(fields, message)});
}

// The result is empty if every field is zero. Encoding cannot fail for messages of the device, whose texts fit their
// fields.
std::vector<uint8_t> Session::serialize_message(const pb_msgdesc_t* fields, const void* message) {
  size_t n_bytes = 0;
  (void)pb_get_encoded_size(&n_bytes, fields, message);
  std::vector<uint8_t> payload(n_bytes);
  pb_ostream_t stream = pb_ostream_from_buffer(payload.data(), payload.size());
  (void)pb_encode(&stream, fields, message);
  return payload;
}

// The sequence number is assigned when the first byte is sent, so that numbers on the line increase regardless of
// queueing.
void Session::frame(ruffini_MessageType type, std::span<const uint8_t> payload) {
  writing_.resize(frames_bound(payload.size()));
  writing_.resize(write_frames(type, identity_.stream_flags, kDeviceSensor, sequence_, payload, writing_));
}

// Returns the slot for a message whose frames are to be sent; a message waiting there is replaced and counted.
Session::Outgoing& Session::newest(uint8_t type) {
  Outgoing& slot = telemetry_[type % kMessageTypes];
  if (slot.is_full) {
    exchange_.telemetry_dropped.fetch_add(1, std::memory_order_relaxed);
    ++n_replaced_;
  }
  slot.is_full = true;
  slot.needs_framing = false;
  slot.order = order_++;
  slot.exposed_us = 0;
  return slot;
}

void Session::take_telemetry() {
  // Lossless: messages stay in the ring until their slot is free, so that the frame thread waits.
  if (identity_.is_lossless &&
      std::any_of(telemetry_.begin(), telemetry_.end(), [](const Outgoing& o) { return o.is_full; })) {
    return;
  }
  TelemetryHead::Bytes bytes{};
  const auto slot = [&] {
    const auto head = std::bit_cast<TelemetryHead>(bytes);
    Outgoing& out = newest(static_cast<uint8_t>(head.type));
    out.exposed_us = head.exposed_us;
    return &out.bytes;
  };
  while (exchange_.telemetry.pop(bytes, slot)) {
    if (identity_.is_lossless) return;
  }
}

void Session::poll(uint64_t now_us) {
  if (started_us_ == 0) started_us_ = now_us;
  delete exchange_.retired_path.exchange(nullptr, std::memory_order_acq_rel);
  const bool is_subscribed = exchange_.every[ruffini_MessageType_MESSAGE_TYPE_STATUS] != 0;
  const bool is_due = status_us_ == 0 || now_us - status_us_ >= kStatusPeriodUs;
  if (is_status_requested_ || (is_subscribed && is_due)) send_status(now_us);
  is_status_requested_ = false;
  if (!calibrator_.is_durable() && now_us - sync_us_ >= kSyncAgainUs) {
    sync_us_ = now_us;
    if (calibrator_.make_durable()) {
      send_event(now_us, ruffini_Event_Severity_SEVERITY_INFO, "calibration_active",
                 "the medium works again: what is in force is so after a power cut, too");
    }
  }
  if (const std::optional<TrialEnd> end = calibrator_.poll()) {
    const auto severity =
        end->is_confirmed ? ruffini_Event_Severity_SEVERITY_INFO : ruffini_Event_Severity_SEVERITY_ERROR;
    send_event(now_us, severity, end->is_in_force ? "calibration_active" : "calibration_reverted", end->text);
  }
  watch_camera(now_us);
  watch_zero(now_us);
  watch_rate(now_us);
  take_telemetry();
}

void Session::watch_camera(uint64_t now_us) {
  if (!exchange_.is_camera_live) {
    stall_.suspend(now_us);
    is_stalled_ = false;
    return;
  }
  const bool was_stalled = is_stalled_;
  const uint64_t silence_us = stall_.silence_us(now_us);
  is_stalled_ = stall_.update(exchange_.frames_processed, now_us);  // frames of a wrong size do not count
  if (is_stalled_ && !was_stalled) {
    send_event(now_us, ruffini_Event_Severity_SEVERITY_ERROR, "camera_stalled",
               "no good frame for " + std::to_string(stall_.silence_us(now_us) / 1'000) + " ms (" +
                   std::to_string(exchange_.frames_captured) + " captured, " +
                   std::to_string(exchange_.frames_invalid) +
                   " of them invalid): see the camera's cable and mode; forces are stale until it is back");
  } else if (was_stalled && !is_stalled_) {
    send_event(now_us, ruffini_Event_Severity_SEVERITY_WARNING, "camera_back",
               "frames come again, after " + std::to_string(silence_us / 1'000) + " ms without a good one");
  }
  if (!is_stalled_) has_cancelled_zero_ = false;
  if (is_stalled_ && !has_cancelled_zero_ && stall_.silence_us(now_us) > kHandsOffUs) cancel_zero(now_us);
  const bool is_asked = exchange_.every[ruffini_MessageType_MESSAGE_TYPE_WRENCH] != 0;
  if (is_stalled_ && is_asked && (!was_stalled || now_us - stale_us_ >= kStalePeriodUs)) {
    stale_us_ = now_us;
    send_stale_wrench();
  }
}

void Session::watch_zero(uint64_t now_us) {
  const uint32_t n = exchange_.refused_zeros;
  if (n == refused_zeros_) return;
  refused_zeros_ = n;
  send_event(now_us, ruffini_Event_Severity_SEVERITY_WARNING, "zero_refused",
             "something came onto the pad, or the light changed, while rest was learned: the previous rest stays; "
             "clear the pad, steady the light and zero again");
}

void Session::watch_rate(uint64_t now_us) {
  const uint32_t divisor = exchange_.rate_divisor;
  if (divisor == rate_divisor_) return;
  rate_divisor_ = divisor;
  if (divisor == 1) {
    send_event(now_us, ruffini_Event_Severity_SEVERITY_INFO, "rate_restored",
               "every frame of the camera is used again");
    return;
  }
  const bool is_throttled = (exchange_.throttled & kClockLowered) != 0;
  send_event(
      now_us, ruffini_Event_Severity_SEVERITY_WARNING, "rate_halved",
      std::string("every second frame of the camera is left out: ") +
          (is_throttled ? "the computer lowers its clock (too warm, or short of power): cool it, or see its supply"
                        : "a frame takes longer than the camera's interval: a faster computer, a smaller "
                          "picture or a lower camera.rate_mhz gives all"));
}

// Before frames arrive again, a finger may lie on the pad; it must not become part of the rest image.
void Session::cancel_zero(uint64_t now_us) {
  has_cancelled_zero_ = true;
  const bool is_asked = exchange_.zero_frames.exchange(kCancelZero) >= 0;
  if (!is_asked && !exchange_.is_zeroing) return;
  send_event(now_us, ruffini_Event_Severity_SEVERITY_WARNING, "zero_given_up",
             "the camera stood still while rest was to be learned: zero again once camera_back is said");
}

std::span<const uint8_t> Session::pending() {
  if (written_ > 0) return std::span<const uint8_t>(writing_).subspan(written_);
  // Selected again until its first byte is sent, so that a blocked line gets the newest message once it accepts bytes.
  writing_.clear();
  offered_ = nullptr;
  if (!replies_.empty()) {
    frame(replies_.front().type, replies_.front().payload);
    return writing_;
  }
  for (Outgoing& slot : telemetry_) {
    if (slot.is_full && (offered_ == nullptr || slot.order < offered_->order)) offered_ = &slot;
  }
  if (offered_ == nullptr) return {};
  if (!offered_->needs_framing) return offered_->bytes;
  frame(static_cast<ruffini_MessageType>(offered_ - telemetry_.data()), offered_->bytes);
  return writing_;
}

void Session::consumed(size_t n_bytes) {
  if (n_bytes == 0) return;
  if (written_ == 0) begin_writing();
  written_ += n_bytes;
  bytes_sent_ += n_bytes;
  if (written_ < writing_.size()) return;
  written_ = 0;
  if (exposed_us_ != 0) latency_.add(exposed_us_, clock_.now_us());
}

// Takes the message offered by pending().
void Session::begin_writing() {
  exposed_us_ = offered_ == nullptr ? 0 : offered_->exposed_us;
  if (offered_ == nullptr) {
    replies_.pop_front();
    ++sequence_;
    return;
  }
  offered_->is_full = false;
  if (offered_->needs_framing) {
    ++sequence_;
  } else {
    writing_ = offered_->bytes;  // not swapped: each slot would come to have room for the largest message
  }
}

void Session::reset_line() {
  access_.reset();
  n_truncated_ += written_ != 0 ? 1 : 0;
  n_dropped_on_hang_up_ += replies_.size();
  written_ = 0;
  writing_.clear();
  replies_.clear();
  for (auto& every : exchange_.every) every = 0;
  while (exchange_.telemetry.pop(writing_)) ++n_dropped_on_hang_up_;
  writing_.clear();
  for (Outgoing& slot : telemetry_) {
    n_dropped_on_hang_up_ += slot.is_full ? 1 : 0;
    slot.is_full = false;
  }
  has_last_reply_ = false;
}

bool Session::is_drained() {
  take_telemetry();
  return pending().empty();
}

}  // namespace ruffini
