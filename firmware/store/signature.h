// Ed25519 verification of calibration files (libsodium). The public development key is built in; anybody can sign with
// it. Once an owner enrols keys of their own, as files on the device, the development key is no longer accepted.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// The signing key: its name, and whether it is the public development key.
struct Signer {
  std::string key_id;
  bool is_development_key = false;
};

class KeyRing {
 public:
  // Accepts the development key only.
  KeyRing() = default;
  // Reads every NAME.pub of a folder: a public key as 64 hexadecimal digits. The development key is accepted if there
  // are none, or on request. Errors: kBadInput naming the file that is not a key; kUnavailable.
  [[nodiscard]] static Result<KeyRing> load(const std::string& folder, bool accepts_development_key);

  // Returns kRefused if the signature matches no accepted key.
  [[nodiscard]] Result<Signer> verify(const Calibration& calibration) const;
  // True if one of the enrolled keys, not the development key, made this signature of 64 bytes.
  [[nodiscard]] bool is_signed_by_enrolled(std::span<const uint8_t> message, std::span<const uint8_t> signature) const;
  [[nodiscard]] bool has_enrolled() const { return !enrolled_.empty(); }
  [[nodiscard]] std::vector<std::string> enrolled_ids() const;
  // True if anybody can make a file that this device accepts; STATUS reports it.
  [[nodiscard]] bool accepts_development_key() const { return accepts_development_key_; }

 private:
  using PublicKey = std::array<uint8_t, 32>;
  std::vector<PublicKey> enrolled_;
  bool accepts_development_key_ = true;
};

// SHA-256 digest of a file.
[[nodiscard]] std::string sha256(std::span<const uint8_t> bytes);

}  // namespace ruffini
