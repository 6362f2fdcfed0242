// Authorization of commands, reading back the calibration, and the time exchange.
#include <pb_decode.h>

#include <algorithm>
#include <cstring>

#include "link/proto_text.h"
#include "link/reply.h"
#include "link/session.h"

namespace ruffini {
namespace {

// True for a command that does more than query, or than select what this host receives.
bool changes_something(const ruffini_Command& request) {
  switch (request.which_action) {
    case ruffini_Command_subscribe_tag:
    case ruffini_Command_get_tag:
    case ruffini_Command_flash_query_tag:
    case ruffini_Command_flash_read_tag:
    case ruffini_Command_challenge_tag:
    case 0:  // a command of a later version: answered as unknown
      return false;
    default:
      return true;
  }
}

}  // namespace

void Session::signed_command(const WireFrame& frame) {
  ruffini_SignedCommand outer = ruffini_SignedCommand_init_zero;
  pb_istream_t stream = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  if (!pb_decode(&stream, ruffini_SignedCommand_fields, &outer)) {
    ++rx_malformed_;
    return;
  }
  const std::span<const uint8_t> bytes(outer.command.bytes, outer.command.size);
  ruffini_Command request = ruffini_Command_init_zero;
  stream = pb_istream_from_buffer(bytes.data(), bytes.size());
  if (!pb_decode(&stream, ruffini_Command_fields, &request)) {
    ++rx_malformed_;
    return;
  }
  if (is_repeat(request)) {  // the original command used up its counter
    command(request, frame.header.sensor, Unit{});
    return;
  }
  const Status fits =
      access_.check(bytes, outer.counter, frame.header.sensor, {outer.signature.bytes, outer.signature.size});
  command(request, frame.header.sensor, fits ? authorize(request, true) : fits);
}

bool Session::is_repeat(const ruffini_Command& request) const {
  return has_last_reply_ && is_remembered(request) && request.request_id == last_request_id_ &&
         request.holder == last_holder_;
}

// Idempotent commands are not remembered, so that one host's queries cannot evict another host's command.
bool Session::is_remembered(const ruffini_Command& request) {
  return changes_something(request) || request.which_action == ruffini_Command_challenge_tag;
}

Status Session::authorize(const ruffini_Command& request, bool is_signed) {
  if (is_repeat(request)) return Unit{};
  if (request.which_action == ruffini_Command_challenge_tag) return access_.is_free_for(request.holder);
  if (!changes_something(request)) return Unit{};
  if (access_.needs_key() && !is_signed) {
    return Error{
        ErrorKind::kRefused,
        "this sensor does that for its owners only: use a host that has one of the keys enrolled here (HELLO names "
        "them)"};
  }
  return access_.acquire(request.holder);
}

void Session::lease(const ruffini_Command& request, ruffini_Reply& reply) {
  if (request.which_action == ruffini_Command_challenge_tag) {
    const Access::Nonce nonce = access_.challenge();
    copy_bytes(reply.nonce, {nonce.begin(), nonce.end()});
    return;
  }
  if (request.holder == 0) {
    reply.code = ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
    copy_text(reply.text, "a lease needs a holder's number above 0");
  } else if (request.action.lease.release) {
    access_.release(request.holder);
  } else {
    access_.set_holder_name(request.holder, to_plain_ascii(request.action.lease.who));
  }
}

void Session::read_back(const ruffini_FlashRead& request, ruffini_Reply& reply) const {
  const ActiveCalibration& active = calibrator_.active();
  const std::string wanted(reinterpret_cast<const char*>(request.sha256.bytes), request.sha256.size);
  if (!active.is_present || wanted != active.sha256) {
    fill_reply(reply, Error{ErrorKind::kRefused, "the calibration that is to be read is not in force: see HELLO"});
    return;
  }
  const std::span<const uint8_t> file = active.file->bytes();
  if (request.offset > file.size()) {
    fill_reply(reply, Error{ErrorKind::kBadInput, "the calibration in force ends before that offset"});
    return;
  }
  const auto piece = file.subspan(request.offset, std::min(sizeof reply.data.bytes, file.size() - request.offset));
  reply.data.size = static_cast<pb_size_t>(piece.size());
  std::copy(piece.begin(), piece.end(), reply.data.bytes);
  reply.next_offset = request.offset + piece.size();
  reply.value = static_cast<int64_t>(file.size());
}

void Session::answer_time(const WireFrame& frame) {
  ruffini_Time m = ruffini_Time_init_zero;
  pb_istream_t stream = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  if (!pb_decode(&stream, ruffini_Time_fields, &m)) {
    ++rx_malformed_;
    return;
  }
  m.received_us = received_us_;
  m.sent_us = clock_.now_us();
  send(ruffini_MessageType_MESSAGE_TYPE_TIME, ruffini_Time_fields, &m);
}

}  // namespace ruffini
