#include "link/access.h"

#include <algorithm>
#include <vector>

namespace ruffini {

Access::Access(const KeyRing& keys, std::string serial, const SessionSeams& seams)
    : keys_(keys), serial_(std::move(serial)), seams_(seams) {}

Access::Nonce Access::challenge() {
  seams_.random.fill(nonce_);
  has_nonce_ = true;
  counter_ = 0;
  return nonce_;
}

// The signed message: proto/ruffini.proto, SignedCommand.
Status Access::check(std::span<const uint8_t> command, uint32_t counter, uint8_t sensor,
                     std::span<const uint8_t> signature) {
  if (!has_nonce_) return Error{ErrorKind::kUnavailable, "no challenge was asked for on this line: ask for one first"};
  if (has_failed_too_often()) {
    return Error{ErrorKind::kBusy, std::to_string(kMaxFailures) +
                                       " wrong signatures within a minute: wait a minute, and see which key it is"};
  }
  if (counter <= counter_) {
    ++n_refused_;
    return Error{ErrorKind::kRefused, "a command with counter " + std::to_string(counter) +
                                          " was taken already: somebody sends again what was sent before"};
  }
  std::vector<uint8_t> message(kDomain, kDomain + sizeof kDomain);  // including its terminating zero
  message.insert(message.end(), serial_.begin(), serial_.end());
  message.push_back(0);
  message.insert(message.end(), nonce_.begin(), nonce_.end());
  for (int shift = 0; shift < 32; shift += 8) message.push_back(static_cast<uint8_t>(counter >> shift));
  message.push_back(sensor);
  message.insert(message.end(), command.begin(), command.end());
  if (!keys_.is_signed_by_enrolled(message, signature)) {
    ++n_refused_;
    count_failure();
    return Error{ErrorKind::kRefused,
                 "the command's signature fits no key that is enrolled here, or not this challenge"};
  }
  counter_ = counter;
  return Unit{};
}

void Access::count_failure() {
  failures_us_[n_failures_ % kMaxFailures] = seams_.clock.now_us();
  ++n_failures_;
}

bool Access::has_failed_too_often() const {
  // The next slot to be written holds the oldest of the last kMaxFailures.
  return n_failures_ >= kMaxFailures && seams_.clock.now_us() - failures_us_[n_failures_ % kMaxFailures] < kFailureUs;
}

bool Access::is_held() const { return holder_ != 0 && seams_.clock.now_us() - renewed_us_ <= kLeaseUs; }

Status Access::is_free_for(uint32_t holder) const {
  if (!is_held() || holder == holder_) return Unit{};
  const uint64_t since_s = (seams_.clock.now_us() - acquired_us_) / 1'000'000;
  return Error{ErrorKind::kBusy, "another host is changing this sensor, for " + std::to_string(since_s) + " s (" +
                                     this->holder() + "): wait for its end, or stop it"};
}

Status Access::acquire(uint32_t holder) {
  const Status is_free = is_free_for(holder);
  if (!is_free) return is_free;
  if (holder == 0) return Unit{};  // a host that predates the lease
  if (!is_held()) {
    if (holder != holder_) holder_name_.clear();
    holder_ = holder;
    acquired_us_ = seams_.clock.now_us();
  }
  renewed_us_ = seams_.clock.now_us();
  return Unit{};
}

void Access::renew(uint32_t holder) {
  if (is_held() && holder == holder_) renewed_us_ = seams_.clock.now_us();
}

void Access::set_holder_name(uint32_t holder, const std::string& who) {
  if (holder != 0 && holder == holder_) holder_name_ = who;
}

void Access::release(uint32_t holder) {
  if (holder == holder_) holder_ = 0;
}

void Access::reset() {
  holder_ = 0;
  has_nonce_ = false;
}

std::string Access::holder() const {
  if (!is_held()) return "";
  return holder_name_.empty() ? "it does not say who it is" : holder_name_;
}

}  // namespace ruffini
