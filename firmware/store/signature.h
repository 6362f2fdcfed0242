// Ed25519 verification of calibration files (libsodium), with the public development key built in.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// Who signed: the key's name, and whether it is the key that anybody can sign with.
struct Signer {
  std::string key_id;
  bool is_development_key = false;
};

// Errors: kRefused where the signature does not fit any key that this device knows.
[[nodiscard]] Result<Signer> verify_signature(const Calibration& calibration);

// SHA-256 of a file.
[[nodiscard]] std::string sha256(std::span<const uint8_t> bytes);

}  // namespace ruffini
