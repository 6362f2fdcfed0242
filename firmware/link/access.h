// Controls who may change the state of this device. Only one host at a time holds the lease. It is acquired with the
// first command that changes something, and ends two seconds after the holder's last command, when the holder releases
// it, or when the line hangs up. If an owner has enrolled keys, the host also needs one: each such command is signed
// over the nonce of a challenge and a counter, so that it cannot be forged, altered, replayed, or sent to another
// device. Link thread only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "base/clock.h"
#include "base/random.h"
#include "base/result.h"
#include "store/signature.h"

namespace ruffini {

// Environment of the session besides its line, and whether commands need no key.
struct SessionSeams {
  const Clock& clock;
  Random& random;
  bool is_open = true;
};

class Access {
 public:
  static constexpr uint64_t kLeaseUs = 2'000'000;
  static constexpr size_t kNonceBytes = 16;
  // Wrong signatures within kFailureUs; then further ones are rejected unchecked
  static constexpr size_t kMaxFailures = 5;
  static constexpr uint64_t kFailureUs = 60'000'000;
  static constexpr char kDomain[] = "ruffini command 1";
  using Nonce = std::array<uint8_t, kNonceBytes>;

  // `keys` must outlive this.
  Access(const KeyRing& keys, std::string serial, const SessionSeams& seams);

  [[nodiscard]] bool needs_key() const { return !seams_.is_open; }
  // Returns a new nonce. Signatures over the previous one are void.
  [[nodiscard]] Nonce challenge();
  // Errors: kUnavailable without a challenge; kBusy after too many failures; kRefused for a counter that was used or a
  // signature that matches no enrolled key.
  [[nodiscard]] Status check(std::span<const uint8_t> command, uint32_t counter, uint8_t sensor,
                             std::span<const uint8_t> signature);
  // Succeeds if no other host holds the lease. Errors: kBusy, naming the holder and the remedy.
  [[nodiscard]] Status is_free_for(uint32_t holder) const;
  // Gives the lease to this holder. Errors: as is_free_for().
  [[nodiscard]] Status acquire(uint32_t holder);
  // The holder has sent a command, or its name.
  void renew(uint32_t holder);
  void set_holder_name(uint32_t holder, const std::string& who);
  void release(uint32_t holder);
  // Ends the lease after a hang-up.
  void reset();
  // Name that the holder has reported; empty: no lease.
  [[nodiscard]] std::string holder() const;
  [[nodiscard]] uint64_t n_refused() const { return n_refused_; }

 private:
  [[nodiscard]] bool is_held() const;
  void count_failure();
  [[nodiscard]] bool has_failed_too_often() const;

  const KeyRing& keys_;
  std::string serial_;
  SessionSeams seams_;
  Nonce nonce_{};
  bool has_nonce_ = false;
  uint32_t counter_ = 0;  // last counter accepted
  std::array<uint64_t, kMaxFailures> failures_us_{};
  size_t n_failures_ = 0;
  uint64_t n_refused_ = 0;
  uint32_t holder_ = 0;
  std::string holder_name_;
  uint64_t acquired_us_ = 0;
  uint64_t renewed_us_ = 0;
};

}  // namespace ruffini
