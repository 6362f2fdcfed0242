// Ed25519 verification of calibration files (libsodium). The public development key is built in: anybody can sign with it,
// so an owner enrols keys of its own, as files on the device, and the development key counts no more.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// Who signed: the key's name, and whether it is the key that anybody can sign with.
struct Signer {
  std::string key_id;
  bool is_development_key = false;
};

class KeyRing {
 public:
  // The development key alone.
  KeyRing() = default;
  // Every NAME.pub of a folder: a public key as 64 hexadecimal digits. With none of them, or where it is asked for, the
  // development key counts, too. Errors: kBadInput with the file that is no key; kUnavailable.
  [[nodiscard]] static Result<KeyRing> load(const std::string& folder, bool accepts_development_key);

  // Errors: kRefused where the signature does not fit any key that this device knows.
  [[nodiscard]] Result<Signer> verify(const Calibration& calibration) const;
  // Whether one of the owners' keys, the development key not among them, made this signature of 64 bytes.
  [[nodiscard]] bool is_of_enrolled(std::span<const uint8_t> message, std::span<const uint8_t> signature) const;
  [[nodiscard]] bool has_enrolled() const { return !enrolled_.empty(); }
  [[nodiscard]] std::vector<std::string> enrolled_ids() const;
  // Then anybody can make a file that this device takes: STATUS says so.
  [[nodiscard]] bool accepts_development_key() const { return accepts_development_key_; }

 private:
  using PublicKey = std::array<uint8_t, 32>;
  std::vector<PublicKey> enrolled_;
  bool accepts_development_key_ = true;
};

// SHA-256 of a file.
[[nodiscard]] std::string sha256(std::span<const uint8_t> bytes);

}  // namespace ruffini
