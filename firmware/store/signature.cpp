#include "store/signature.h"

#include <sodium.h>

#include <array>

namespace ruffini {
namespace {

using PublicKey = std::array<uint8_t, crypto_sign_PUBLICKEYBYTES>;

// Key pair of the published seed SHA-256("ruffini development key").
PublicKey development_key() {
  constexpr char kPhrase[] = "ruffini development key";
  std::array<uint8_t, crypto_hash_sha256_BYTES> seed{};
  crypto_hash_sha256(seed.data(), reinterpret_cast<const uint8_t*>(kPhrase), sizeof kPhrase - 1);
  PublicKey public_key{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_key{};
  crypto_sign_seed_keypair(public_key.data(), secret_key.data(), seed.data());
  return public_key;
}

std::string key_id(const PublicKey& key) {
  const std::string hash = sha256(key);
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string id;
  for (size_t i = 0; i < 4; ++i) {
    id += kDigits[static_cast<uint8_t>(hash[i]) >> 4];
    id += kDigits[static_cast<uint8_t>(hash[i]) & 15];
  }
  return id;
}

}  // namespace

std::string sha256(std::span<const uint8_t> bytes) {
  std::array<uint8_t, crypto_hash_sha256_BYTES> hash{};
  crypto_hash_sha256(hash.data(), bytes.data(), bytes.size());
  return {hash.begin(), hash.end()};
}

Result<Signer> verify_signature(const Calibration& calibration) {
  if (sodium_init() < 0) return Error{ErrorKind::kUnavailable, "libsodium does not start: check its installation"};
  static const PublicKey kDevelopment = development_key();
  const std::span<const uint8_t> message = calibration.signed_bytes();
  if (crypto_sign_verify_detached(calibration.signature().data(), message.data(), message.size(),
                                  kDevelopment.data()) != 0) {
    return Error{ErrorKind::kRefused, "the calibration's signature fits no key of this device (the file names key " +
                                          std::string(calibration.text("key_id")) +
                                          "): it was changed, or signed with another key"};
  }
  return Signer{key_id(kDevelopment), true};
}

}  // namespace ruffini
