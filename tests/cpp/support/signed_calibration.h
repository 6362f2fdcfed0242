// Signs test calibrations with the development key, as anybody may (proto/CALIBRATION.md).
#pragma once

#include <sodium.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <vector>

namespace ruffini::test {

// `file` ends with the signature, 64 bytes over all that comes before.
inline std::vector<uint8_t> sign(std::vector<uint8_t> file) {
  constexpr char kPhrase[] = "ruffini development key";
  std::array<uint8_t, crypto_hash_sha256_BYTES> seed{};
  crypto_hash_sha256(seed.data(), reinterpret_cast<const uint8_t*>(kPhrase), sizeof kPhrase - 1);
  std::array<uint8_t, crypto_sign_PUBLICKEYBYTES> public_key{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_key{};
  crypto_sign_seed_keypair(public_key.data(), secret_key.data(), seed.data());
  const size_t n_signed = file.size() - crypto_sign_BYTES;
  crypto_sign_detached(file.data() + n_signed, nullptr, file.data(), n_signed, secret_key.data());
  return file;
}

}  // namespace ruffini::test
