#include "host.h"

#include <pb_decode.h>
#include <pb_encode.h>

#include <algorithm>
#include <cstring>

#include "failure.h"

namespace ruffini::sim {
namespace {

constexpr uint64_t kReadEveryUs = 5'000;
constexpr uint64_t kHelloWaitUs = 600'000;
constexpr uint64_t kBusyWaitUs = 500'000;
constexpr uint64_t kReplyWaitUs = 500'000;
constexpr uint64_t kReplyTries = 12;
constexpr uint64_t kChunkWaitUs = 100'000;
constexpr uint64_t kChunkTries = 40;
constexpr uint64_t kCommitWaitUs = 1'000'000;
constexpr uint64_t kTrialPollUs = 100'000;
constexpr uint64_t kFlashUs = 40'000'000;  // then a person gives up
constexpr uint64_t kLiftsUs = 500'000;     // who zeroes a sensor takes the finger off first
constexpr uint64_t kLearnsUs = 2'000'000;  // longer than rest is learned for, and than a command is late
constexpr uint64_t kLongestPauseUs = 8'000'000;

}  // namespace

uint64_t Host::step() {
  if (!line_.is_connected()) {
    stage_ = Stage::kClosed;
    return UINT64_MAX;
  }
  if (stage_ == Stage::kClosed) open();
  if (swarm_.strikes(Fault::kHostReadsSlowly, 200)) reads_from_us_ = now_us_ + dice_.between(500'000, kLongestPauseUs);
  if (swarm_.strikes(Fault::kHostFloods, 100)) flood();
  if (swarm_.strikes(Fault::kHostRestarts, 100)) open();
  if (now_us_ >= reads_from_us_) read();
  if (now_us_ >= due_us_) go_on();
  return std::max(std::min(due_us_, now_us_ + kReadEveryUs), now_us_ + 100);
}

void Host::open() {
  wants_zero_ = false;
  log_.say(now_us_, "a host opens the line");
  decoder_ = ReferenceDecoder();
  request_id_ = static_cast<uint32_t>(dice_.below(1 << 24)) + 1;
  // A few take no lease; to them HELLO means that they begin.
  holder_ = dice_.chance(kMillion / 4) ? 0 : static_cast<uint32_t>(dice_.below(UINT32_MAX)) + 1;
  judge_.host_restarted();
  if (!is_wanted_ && dice_.chance(kMillion / 4)) table_ = nullptr;  // another program, which knows nothing of it
  greet();
}

void Host::greet() {
  stage_ = Stage::kHello;
  due_us_ = now_us_ + kHelloWaitUs;
  line_.host_write(Bytes{0});
  write(ruffini_MessageType_MESSAGE_TYPE_HELLO, {});
}

void Host::read() {
  const Bytes bytes = line_.host_read(dice_.between(1, 8'192));
  for (const uint8_t byte : bytes) {
    if (const auto frame = decoder_.push(byte, now_us_)) take(*frame);
  }
}

void Host::take(const ReferenceFrame& frame) {
  if ((frame.flags & 1) != 0 || frame.fragment != 0 || frame.n_fragments != 1) return;
  pb_istream_t in = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  if (frame.type == ruffini_MessageType_MESSAGE_TYPE_HELLO && stage_ == Stage::kHello) {
    ruffini_Hello hello = ruffini_Hello_init_zero;
    if (pb_decode(&in, ruffini_Hello_fields, &hello)) greeted(hello);
  } else if (frame.type == ruffini_MessageType_MESSAGE_TYPE_REPLY) {
    ruffini_Reply reply = ruffini_Reply_init_zero;
    if (pb_decode(&in, ruffini_Reply_fields, &reply)) replied(reply);
  } else if (frame.type == ruffini_MessageType_MESSAGE_TYPE_WRENCH) {
    ruffini_Wrench wrench = ruffini_Wrench_init_zero;
    const bool is_whole = pb_decode(&in, ruffini_Wrench_fields, &wrench);
    if (is_whole && wrench.validity_count == 6 && wrench.validity[0] == ruffini_Validity_VALIDITY_VALID)
      ++n_fresh_forces_;
  }
}

void Host::greeted(const ruffini_Hello& hello) {
  const auto& hash = hello.sensors[0].calibration.sha256;
  in_force_.assign(reinterpret_cast<const char*>(hash.bytes), hash.size);
  ruffini_Command m = command(ruffini_Command_subscribe_tag);
  auto& subscribe = m.action.subscribe;
  const std::pair<ruffini_MessageType, uint64_t> wanted[] = {
      {ruffini_MessageType_MESSAGE_TYPE_WRENCH, is_wanted_ ? 1 : dice_.between(1, 3)},
      {ruffini_MessageType_MESSAGE_TYPE_STATUS, 1},
      {ruffini_MessageType_MESSAGE_TYPE_MARKERS, dice_.chance(kMillion / 3) ? dice_.between(1, 20) : 0}};
  for (const auto& [type, every] : wanted) {
    subscribe.subscriptions[subscribe.subscriptions_count++] = {type, static_cast<uint32_t>(every)};
  }
  ask(m, Stage::kSubscribe, kReplyWaitUs, kReplyTries);
}

void Host::replied(const ruffini_Reply& reply) {
  if (stage_ == Stage::kHello || stage_ == Stage::kIdle || stage_ == Stage::kPause || stage_ == Stage::kClosed) return;
  if (reply.request_id == 0) {
    send_again();
    return;
  }
  if (reply.request_id != request_id_) return;
  if (reply.code == ruffini_ReplyCode_REPLY_BUSY) {  // the lease of a host that is gone lasts a little longer
    stage_ = Stage::kIdle;
    due_us_ = now_us_ + kBusyWaitUs;
    return;
  }
  const bool is_ok = reply.code == ruffini_ReplyCode_REPLY_OK;
  switch (stage_) {
    case Stage::kSubscribe:
      want(is_ok, "a subscription is granted");
      stage_ = Stage::kIdle;
      due_us_ = now_us_ + dice_.between(20'000, 2'000'000);
      if (table_ != nullptr) due_us_ = now_us_ + 1'000;
      return;
    case Stage::kBegin:
    case Stage::kChunk:
      if (reply.next_offset >= table_->bytes.size()) {
        ask(command(ruffini_Command_flash_commit_tag), Stage::kCommit, kCommitWaitUs, kReplyTries);
      } else if (reply.flash_state == ruffini_FlashState_FLASH_STATE_IDLE) {
        begin();  // the device was restarted
      } else {
        chunk_bytes_ = reply.next_offset;
        send_chunk();
      }
      return;
    case Stage::kCommit:
      if (is_ok && reply.flash_state == ruffini_FlashState_FLASH_STATE_DURABLE) {
        want(table_->is_good, table_->name + ": no table is taken that fails its checks");
        stage_ = Stage::kPause;
        due_us_ = now_us_ + kTrialPollUs;
      } else if (is_wanted_) {
        begin();
      } else {
        flash_ended();
      }
      return;
    case Stage::kQuery:
      if (is_ok && reply.flash_state == ruffini_FlashState_FLASH_STATE_DURABLE) {
        stage_ = Stage::kPause;
        due_us_ = now_us_ + kTrialPollUs;
      } else {
        // With a text it is in force, and may not be so after a restart.
        const bool is_active = reply.flash_state == ruffini_FlashState_FLASH_STATE_ACTIVE;
        const bool is_success = is_ok && is_active && reply.text[0] == '\0';
        if (is_active && !is_success && is_wanted_) return begin();
        if (is_success) ++n_flashed_;
        has_flashed_ = has_flashed_ || (is_wanted_ && is_success);
        flash_ended();
      }
      return;
    default:
      stage_ = Stage::kIdle;
      due_us_ = now_us_ + dice_.between(20'000, 2'000'000);
  }
}

void Host::go_on() {
  if (stage_ == Stage::kIdle) {
    next_job();
  } else if (stage_ == Stage::kPause) {
    query();
  } else if (stage_ == Stage::kHello || tries_ == 0) {
    greet();
  } else {
    --tries_;
    send_again();
    due_us_ = now_us_ + wait_us_;
  }
}

void Host::next_job() {
  if (table_ != nullptr && now_us_ > flash_until_us_ && !is_wanted_) table_ = nullptr;
  if (table_ != nullptr) {
    if (in_force_ == table_->sha256) return query();
    return begin();
  }
  if (wants_zero_) {
    wants_zero_ = false;
    ruffini_Command m = command(ruffini_Command_zero_tag);
    m.action.zero.n_frames = static_cast<uint32_t>(dice_.between(1, 20));
    return ask(m, Stage::kOther, kReplyWaitUs, kReplyTries);
  }
  const uint64_t drawn = swarm_.is_calm() ? 99 : dice_.below(100);  // in the end, only what it is told
  if (drawn < 35) {
    const bool is_bad = swarm_.strikes(Fault::kBadTable, 300'000);
    table_ =
        &sensor_
             .tables[is_bad ? dice_.between(sensor_.n_good, sensor_.tables.size() - 1) : dice_.below(sensor_.n_good)];
    flash_until_us_ = now_us_ + kFlashUs;
    begin();
  } else if (drawn < 50) {
    ask(command(ruffini_Command_flash_undo_tag), Stage::kOther, kCommitWaitUs, kReplyTries);
  } else if (drawn < 60) {
    hands_off_until_us_ = now_us_ + kLiftsUs + kReplyWaitUs * (kReplyTries + 1) + kLearnsUs;
    due_us_ = now_us_ + kLiftsUs;
    wants_zero_ = true;
  } else {
    ruffini_Command m = command(ruffini_Command_get_tag);
    std::strcpy(m.action.get.key, drawn < 80 ? "frames_processed" : "nothing");
    ask(m, Stage::kOther, kReplyWaitUs, kReplyTries);
  }
}

void Host::begin() {
  ruffini_Command m = command(ruffini_Command_flash_begin_tag);
  m.action.flash_begin.size_bytes = table_->bytes.size();
  m.action.flash_begin.sha256.size = 32;
  std::memcpy(m.action.flash_begin.sha256.bytes, table_->sha256.data(), 32);
  ask(m, Stage::kBegin, kReplyWaitUs, kReplyTries);
}

void Host::send_chunk() {
  ruffini_Command m = command(ruffini_Command_flash_chunk_tag);
  auto& chunk = m.action.flash_chunk;
  chunk.offset = chunk_bytes_;
  const size_t n = std::min<size_t>(table_->bytes.size() - chunk_bytes_, dice_.between(100, 900));
  chunk.data.size = static_cast<pb_size_t>(n);
  std::copy_n(table_->bytes.begin() + static_cast<ptrdiff_t>(chunk_bytes_), n, chunk.data.bytes);
  ask(m, Stage::kChunk, kChunkWaitUs, kChunkTries);
}

void Host::query() {
  ruffini_Command m = command(ruffini_Command_flash_query_tag);
  m.action.flash_query.sha256.size = 32;
  std::memcpy(m.action.flash_query.sha256.bytes, table_->sha256.data(), 32);
  if (now_us_ > flash_until_us_ && !is_wanted_) return flash_ended();
  ask(m, Stage::kQuery, kReplyWaitUs, kReplyTries);
}

void Host::flash_ended() {
  if (!is_wanted_ || has_flashed_) table_ = nullptr;
  is_wanted_ = is_wanted_ && !has_flashed_;
  greet();  // who is the sensor now?
}

void Host::flash_now(const Table& table) {
  table_ = &table;
  is_wanted_ = true;
  has_flashed_ = false;
  if (line_.is_connected()) greet();
}

ruffini_Command Host::command(pb_size_t action) {
  ruffini_Command m = ruffini_Command_init_zero;
  m.which_action = action;
  return m;
}

void Host::ask(const ruffini_Command& wanted, Stage stage, uint64_t wait_us, uint64_t tries) {
  ruffini_Command m = wanted;
  m.request_id = request_id_ = request_id_ == UINT32_MAX ? 1 : request_id_ + 1;
  m.holder = holder_;
  asked_.resize(ruffini_Command_size);
  pb_ostream_t stream = pb_ostream_from_buffer(asked_.data(), asked_.size());
  want(pb_encode(&stream, ruffini_Command_fields, &m), "a command can be encoded");
  asked_.resize(stream.bytes_written);
  stage_ = stage;
  wait_us_ = wait_us;
  tries_ = tries;
  due_us_ = now_us_ + wait_us;
  write(ruffini_MessageType_MESSAGE_TYPE_COMMAND, asked_);
}

void Host::send_again() {
  line_.host_write(Bytes{0});
  write(ruffini_MessageType_MESSAGE_TYPE_COMMAND, asked_);
}

void Host::write(uint8_t type, std::span<const uint8_t> payload) {
  line_.host_write(reference_frame(type, payload, sequence_++));
}

// More than the device keeps replies for.
void Host::flood() {
  for (uint64_t i = dice_.between(50, 300); i > 0; --i) {
    const uint64_t drawn = dice_.below(holder_ == 0 ? 2 : 3);
    write(drawn == 0   ? ruffini_MessageType_MESSAGE_TYPE_SCHEMA
          : drawn == 1 ? ruffini_MessageType_MESSAGE_TYPE_STATUS
                       : ruffini_MessageType_MESSAGE_TYPE_HELLO,
          {});
  }
}

}  // namespace ruffini::sim
