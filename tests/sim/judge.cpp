#include "judge.h"

#include <pb_decode.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>

#include "failure.h"
#include "link/stall_watch.h"
#include "store/signature.h"

namespace ruffini::sim {
namespace {

constexpr uint64_t kAnswerUs = 2'000'000;  // a command on a line that takes what is written
constexpr uint64_t kOldestUs = 1'500'000;  // of a force that is not marked as stale
constexpr size_t kMaxAsks = 60;            // more at once than the device keeps replies need no answer
constexpr uint64_t kGoodFrames = 32;       // of a trial, as proto/README.md says
constexpr uint64_t kTrialFrames = 256;
constexpr size_t kX = 0;

template <typename Message>
Message decoded(const ReferenceFrame& frame, const pb_msgdesc_t* fields, Message empty) {
  pb_istream_t in = pb_istream_from_buffer(frame.payload.data(), frame.payload.size());
  want(pb_decode(&in, fields, &empty), "what the device says is a message of the schema");
  return empty;
}

std::string text_of(const auto& bytes) { return {reinterpret_cast<const char*>(bytes.bytes), bytes.size}; }

}  // namespace

void Judge::booted(const Calibrator& calibrator, const Exchange& exchange, const SimCamera& camera,
                   const std::string& problem) {
  calibrator_ = &calibrator;
  exchange_ = &exchange;
  camera_ = &camera;
  seen_ = truth();
  want(seen_.sha256.empty() || sensor_.good_by_sha256(seen_.sha256) != nullptr,
       "no table is in force that fails its checks");
  want(!seen_.is_on_trial, "a restart ends a trial");
  if (disk_.has_failed()) {
    want(!problem.empty() || !now_ || *now_ == seen_.sha256, "a start without the calibration in force says why");
    now_ = before_ = std::nullopt;
  } else {
    want(!now_ || *now_ == seen_.sha256, "what was in force is so after a restart");
    if (!now_) before_ = std::nullopt;
    now_ = seen_.sha256;
  }
  used_ = {seen_.sha256};
  sure_us_[seen_.sha256] = now_us_;
  from_device_ = to_device_ = ReferenceDecoder();
  sequence_.clear();
  delivered_.clear();
  former_.clear();
  run_.clear();
  owed_.clear();
  n_encoded_ = n_sent_ = n_lost_ = n_stalled_steps_ = 0;
  is_mailbox_full_ = false;
  processed_us_ = now_us_;
}

void Judge::stopped(bool in_store) {
  // The new one or the old one.
  if (in_store) now_ = before_ = std::nullopt;
  calibrator_ = nullptr;
}

void Judge::host_restarted() {
  former_.merge(delivered_);
  delivered_.clear();
  run_.clear();
}

void Judge::before_serving() {
  asked_.clear();
  zero_before_ = exchange_->zero_frames;
}

void Judge::after_serving(bool is_line_up, bool has_room) {
  observe();
  if (was_asked(ruffini_Command_flash_undo_tag) && disk_.has_failed()) now_ = before_ = std::nullopt;  // done or not
  const int zero = exchange_->zero_frames;
  want(zero < 0 || zero_before_ >= 0 || ran(ruffini_Command_zero_tag), "a zero is run once");
  if (!is_line_up) {
    owed_.clear();
    from_device_ = ReferenceDecoder();
    n_lost_ = n_encoded_ - n_sent_ - static_cast<int64_t>(exchange_->telemetry_dropped);
    n_stalled_steps_ = 0;
  }
  if (!has_room) blocked_us_ = now_us_;
  check_drops();
  while (blocked_us_ + kAnswerUs > now_us_ && !owed_.empty() && owed_.front().at_us < blocked_us_) owed_.pop_front();
  want(owed_.empty() || owed_.front().at_us + kAnswerUs > now_us_, "no reply is lost while the line is up");
}

void Judge::received(std::span<const uint8_t> bytes) {
  observe();  // what the device did of itself, before it heard this
  size_t n_asks = 0;
  for (const uint8_t byte : bytes) {
    const auto frame = to_device_.push(byte, now_us_);
    if (!frame || (frame->flags & 1) == 0 || frame->n_fragments != 1) continue;
    ++n_asks;
    if (frame->type != ruffini_MessageType_MESSAGE_TYPE_COMMAND) continue;
    ruffini_Command command = ruffini_Command_init_zero;
    pb_istream_t in = pb_istream_from_buffer(frame->payload.data(), frame->payload.size());
    if (!pb_decode(&in, ruffini_Command_fields, &command)) continue;
    delivered_.emplace(command.request_id, now_us_);
    asked_.emplace_back(command.request_id, command.which_action);
    if (command.which_action == ruffini_Command_flash_query_tag) {
      queried_[command.request_id] = text_of(command.action.flash_query.sha256);
    }
    owed_.push_back({command.request_id, now_us_});
    log_.say(now_us_, "command", {command.request_id, command.which_action});
  }
  if (n_asks > kMaxAsks || owed_.size() > kMaxAsks) owed_.clear();
}

bool Judge::was_asked(pb_size_t action) const {
  return std::any_of(asked_.begin(), asked_.end(), [&](const auto& a) { return a.second == action; });
}

// A request may come again: it is run the first time, or later where it was refused before.
bool Judge::ran(pb_size_t action) {
  const auto found = std::find_if(asked_.rbegin(), asked_.rend(),
                                  [&](const auto& a) { return a.second == action && run_.count(a.first) == 0; });
  if (found == asked_.rend()) return false;
  run_.insert(found->first);
  return true;
}

void Judge::observe() {
  const Truth after = truth();
  if (!after.is_on_trial) sure_us_[after.sha256] = now_us_;
  if (after == seen_) return;
  const Truth before = seen_;
  seen_ = after;
  want(after.sha256.empty() || sensor_.good_by_sha256(after.sha256) != nullptr,
       "no table is in force that fails its checks");
  used_.insert(after.sha256);
  log_.say(now_us_, after.is_on_trial ? "on trial" : "in force",
           {after.sha256.empty() ? 0 : sensor_.by_sha256.at(after.sha256)});
  changed(before, after);
  if (!after.is_on_trial) sure_us_[after.sha256] = now_us_;
}

void Judge::changed(const Truth& before, const Truth& after) {
  if (after.is_on_trial) {
    want(!before.is_on_trial, "a trial is ended before the next");
    want(ran(ruffini_Command_flash_commit_tag), "a commit is run once");
    trial_frames_ = trial_good_ = 0;
    tried_over_ = before.sha256;
  } else if (before.is_on_trial) {
    trial_ended(before, after);
  } else {
    want(ran(ruffini_Command_flash_undo_tag), "an undo is run once");
    // A file that cannot be read is passed over for the one before it.
    want(!before_ || *before_ == after.sha256 || disk_.has_failed(), "an undo brings back what was before");
    before_ = before.sha256;
    now_ = after.sha256;
  }
  if (disk_.has_failed()) now_ = before_ = std::nullopt;  // until the next start says what the medium kept
}

void Judge::trial_ended(const Truth& before, const Truth& after) {
  log_.say(now_us_, "trial ended", {trial_good_, trial_frames_});
  const bool is_same =
      tried_over_ == before.sha256;  // the file that was in force again: confirmed or reverted, who knows
  if (is_same) before_ = std::nullopt;
  if (before.sha256 == after.sha256 && !is_same && !disk_.has_failed()) {
    want(trial_good_ >= kGoodFrames, "a calibration is confirmed by good frames");
  }
  if (before.sha256 == after.sha256 && trial_good_ >= kGoodFrames) {
    ++n_confirmed_;
    if (!is_same) before_ = now_;
    now_ = after.sha256;
    return;
  }
  ++n_reverted_;
  const bool is_asked = ran(ruffini_Command_flash_undo_tag);
  want(is_asked || trial_frames_ >= kTrialFrames || disk_.has_failed(), "a trial has all of its frames");
  want(tried_over_ == after.sha256 || disk_.has_failed(), "a trial's end brings back what was before");
}

void Judge::sent(std::span<const uint8_t> bytes) {
  for (const uint8_t byte : bytes) {
    const uint64_t n_before = from_device_.n_damaged();
    const auto frame = from_device_.push(byte, now_us_);
    want(from_device_.n_damaged() == n_before, "the device writes whole frames");
    if (!frame || frame->fragment != 0) continue;
    want((frame->flags & 1) == 0 && (frame->flags & 2) != 0, "frames say where they come from");
    check_sequence(*frame);
    if (frame->sensor == 0) ++n_sent_;
    switch (frame->type) {
      case ruffini_MessageType_MESSAGE_TYPE_WRENCH:
        check_wrench(*frame);
        break;
      case ruffini_MessageType_MESSAGE_TYPE_REPLY:
        check_reply(*frame);
        break;
      case ruffini_MessageType_MESSAGE_TYPE_STATUS:
        check_status(*frame);
        break;
      default:
        log_.say(now_us_, "message", {frame->type});
    }
  }
}

void Judge::check_sequence(const ReferenceFrame& frame) {
  const auto [at, is_first] = sequence_.emplace(frame.sensor, frame.sequence);
  want(is_first || frame.sequence > at->second, "sequence numbers grow");
  at->second = frame.sequence;
}

void Judge::check_wrench(const ReferenceFrame& frame) {
  const auto m = decoded(frame, ruffini_Wrench_fields, ruffini_Wrench(ruffini_Wrench_init_zero));
  log_.say(now_us_, "wrench",
           {m.stamp.frame, m.stamp.flags, m.stamp.calibration_id, static_cast<uint64_t>(m.force_x_un)});
  const bool is_valid = std::any_of(m.validity, m.validity + m.validity_count,
                                    [](ruffini_Validity v) { return v == ruffini_Validity_VALIDITY_VALID; });
  if ((m.stamp.flags & ruffini_FlagBit_FLAG_STALE) != 0) {
    ++n_stale_;
    want(!is_valid, "a stale wrench has no valid number");
    return;
  }
  const auto shown = camera_->shown(m.stamp.frame);
  const bool is_time_marked = (m.stamp.flags & ruffini_FlagBit_FLAG_TIME) != 0;
  want(shown.has_value() && (is_time_marked || shown->capture_us == m.stamp.capture_us),
       "a stamp is that of its frame");
  if (!is_valid) return;
  ++n_valid_;
  const Table* table = sensor_.good_by_id(m.stamp.calibration_id);
  want(table != nullptr && used_.count(table->sha256) != 0, "a force is of a calibration that is in force");
  want(shown->picture < kTouches, "a frame that shows nothing is no force");
  want(table->is_valid[shown->picture], "a frame that contradicts itself is no force");
  want(std::abs(m.force_x_un - table->force_un[shown->picture]) <= kForceLimitUn,
       "a force that is not marked is right");
  want(frame.begun_us < shown->taken_us + kOldestUs, "a force that is not marked as stale is new");
  want(m.validity[kX] == ruffini_Validity_VALIDITY_VALID, "what is measured is valid together");
}

void Judge::check_reply(const ReferenceFrame& frame) {
  const auto m = decoded(frame, ruffini_Reply_fields, ruffini_Reply(ruffini_Reply_init_zero));
  log_.say(now_us_, "reply", {m.request_id, static_cast<uint64_t>(m.code), static_cast<uint64_t>(m.flash_state)});
  if (m.request_id == 0) return;  // asks for what came damaged
  const auto asked = delivered_.find(m.request_id);
  want(asked != delivered_.end() || former_.count(m.request_id) != 0, "a reply is to a command that came");
  const auto owed =
      std::find_if(owed_.begin(), owed_.end(), [&](const Owed& o) { return o.request_id == m.request_id; });
  if (owed != owed_.end()) owed_.erase(owed);
  const auto queried = queried_.find(m.request_id);
  if (asked == delivered_.end() || queried == queried_.end() || m.code != ruffini_ReplyCode_REPLY_OK) return;
  if (m.flash_state != ruffini_FlashState_FLASH_STATE_ACTIVE || m.text[0] != '\0') return;
  want(is_kept(queried->second), "success is said of what a power cut leaves");
  const auto sure = sure_us_.find(queried->second);
  want(sure != sure_us_.end() && sure->second >= asked->second, "success is said of what is in force for good");
}

// True if a power cut leaves this calibration in force now, or if another one has taken its place since the reply.
bool Judge::is_kept(const std::string& hash) const {
  if (seen_.sha256 != hash || seen_.is_on_trial) return true;
  constexpr std::string_view kName = "calibration-";
  uint64_t newest = 0;
  const test::Inode* kept = nullptr;
  const test::Names names = disk_.medium().names_after(0);
  for (const auto& [name, inode] : names) {
    if (name.compare(0, kName.size(), kName) != 0) continue;
    const uint64_t number = std::stoull(name.substr(kName.size()));
    if (number > newest) newest = number, kept = inode.get();
  }
  return kept != nullptr && sha256(kept->bytes) == hash;
}

void Judge::check_status(const ReferenceFrame& frame) {
  const auto m = decoded(frame, ruffini_Status_fields, ruffini_Status(ruffini_Status_init_zero));
  const uint64_t accounted =
      m.frames_processed + m.drops.capture_overrun + m.drops.invalid_frame + m.repeated_frames + m.frames_left_out;
  log_.say(now_us_, "status", {m.frames_captured, m.frames_processed, m.drops.link_backpressure, m.health});
  want(m.frames_captured == accounted || m.frames_captured == accounted + 1, "STATUS accounts for every frame");
}

void Judge::after_capture(bool is_mailbox_full) {
  is_mailbox_full_ = is_mailbox_full;
  check_counters();
}

void Judge::after_frame() {
  is_mailbox_full_ = false;
  processed_us_ = now_us_;
  check_counters();
  for (const uint8_t type : {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_MARKERS}) {
    const uint32_t every = exchange_->every[type];
    if (every != 0 && (exchange_->frames_processed - 1) % every == 0) ++n_encoded_;
  }
  const Table* trial = seen_.is_on_trial ? sensor_.good_by_sha256(seen_.sha256) : nullptr;
  if (trial == nullptr || trial->id != exchange_->last_frame.calibration_id) return;
  ++trial_frames_;
  const auto shown = camera_->shown(exchange_->last_frame.number);
  const bool is_good = shown->picture < kTouches && trial->is_valid[shown->picture];
  if (is_good) ++trial_good_;
}

// captured = processed + overrun + invalid + not used + left out + in flight.
void Judge::check_counters() {
  const Exchange& e = *exchange_;
  want(e.frames_captured == camera_->n_given(), "every frame of the camera is counted");
  const uint64_t accounted =
      e.frames_processed + e.frames_overrun + e.frames_invalid + e.frames_repeated + e.frames_left_out;
  want(e.frames_captured == accounted + (is_mailbox_full_ ? 1 : 0), "a frame is processed, or its drop is counted");
}

// What waits is in the ring or in one of the session's slots.
void Judge::check_drops() {
  constexpr int64_t kWaiting = 3;  // two types, and the one that is being written
  if (processed_us_ + StallWatch::kMinUs < now_us_) ++n_stalled_steps_;
  const int64_t accounted = n_sent_ + static_cast<int64_t>(exchange_->telemetry_dropped) + n_lost_;
  want(accounted <= n_encoded_ + n_stalled_steps_ && n_encoded_ <= accounted + kWaiting,
       "a message is sent, or its drop is counted: of " + std::to_string(n_encoded_) + " made, " +
           std::to_string(accounted) + " are accounted for");
}

}  // namespace ruffini::sim
