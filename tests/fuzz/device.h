// What the targets of the device share: a small board, its calibration, and how a broken promise ends a run.
#pragma once

#include <array>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "input.h"
#include "link/calibrator.h"
#include "support/signed_calibration.h"
#include "support/small_board.h"
#include "support/test_calibration.h"

namespace ruffini::fuzz {

inline void expect(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "broken promise: %s\n", what);
  std::abort();
}

inline BoardSettings small_board() { return test::small_board({"operator", "support", "wrench", "contacts"}); }

// Ed25519 by the development key over all but the last 64 bytes.
inline bool is_signed(const Bytes& file) {
  constexpr char kPhrase[] = "ruffini development key";
  std::array<uint8_t, crypto_hash_sha256_BYTES> seed{};
  crypto_hash_sha256(seed.data(), reinterpret_cast<const uint8_t*>(kPhrase), sizeof kPhrase - 1);
  std::array<uint8_t, crypto_sign_PUBLICKEYBYTES> public_key{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_key{};
  crypto_sign_seed_keypair(public_key.data(), secret_key.data(), seed.data());
  if (file.size() < crypto_sign_BYTES) return false;
  const size_t n = file.size() - crypto_sign_BYTES;
  return crypto_sign_verify_detached(file.data() + n, file.data(), n, public_key.data()) == 0;
}

}  // namespace ruffini::fuzz
