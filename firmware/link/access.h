// Who may change something on this device. One host at a time: the lease, taken with the first command that changes
// something, ends two seconds after the last command of its holder, when that gives it back, or when the line hangs up.
// And where an owner has enrolled keys, only who has one: each such command is signed over the nonce of a challenge and a
// counter, so that none can be made up, changed, sent again, or sent to another device. Link thread only.
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

// What the session needs of the world beside its line, and whether a key is asked for.
struct SessionSeams {
  const Clock& clock;
  Random& random;
  bool is_open = true;
};

class Access {
 public:
  static constexpr uint64_t kLeaseUs = 2'000'000;
  static constexpr size_t kNonceBytes = 16;
  static constexpr size_t kMaxFailures = 5;  // wrong signatures within kFailureUs; then none is looked at
  static constexpr uint64_t kFailureUs = 60'000'000;
  static constexpr char kDomain[] = "ruffini command 1";
  using Nonce = std::array<uint8_t, kNonceBytes>;

  // `keys` must outlive this.
  Access(const KeyRing& keys, std::string serial, const SessionSeams& seams);

  [[nodiscard]] bool needs_key() const { return !seams_.is_open; }
  // A new nonce; what was signed under the one before is void.
  [[nodiscard]] Nonce challenge();
  // Errors: kUnavailable without a challenge; kBusy after too many failures; kRefused for a counter that was used and a
  // signature that fits no enrolled key.
  [[nodiscard]] Status check(std::span<const uint8_t> command, uint32_t counter, uint8_t sensor,
                             std::span<const uint8_t> signature);
  // Whether nobody else has the lease. Errors: kBusy; who has it, and what to do.
  [[nodiscard]] Status is_free_for(uint32_t holder) const;
  // The lease is this holder's from now on. Errors: as is_free_for().
  [[nodiscard]] Status take(uint32_t holder);
  // The holder is there still, or what it says of itself.
  void heard(uint32_t holder);
  void name(uint32_t holder, const std::string& who);
  void release(uint32_t holder);
  // The line hung up.
  void forget();
  // What the holder says of itself; empty: nobody has the lease.
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
  uint32_t counter_ = 0;  // the last one that was taken
  std::array<uint64_t, kMaxFailures> failures_us_{};
  size_t n_failures_ = 0;
  uint64_t n_refused_ = 0;
  uint32_t holder_ = 0;
  std::string who_;
  uint64_t taken_us_ = 0;
  uint64_t heard_us_ = 0;
};

}  // namespace ruffini
