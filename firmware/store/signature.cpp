#include "store/signature.h"

#include <sodium.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <optional>

namespace ruffini {
namespace {

using PublicKey = std::array<uint8_t, crypto_sign_PUBLICKEYBYTES>;
constexpr int kMaxDigits = 2 * crypto_sign_PUBLICKEYBYTES + 1;  // read limit: one more than a key has

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

std::optional<PublicKey> parse_key(const std::string& digits) {
  PublicKey key{};
  size_t n = 0;
  const char* end = nullptr;
  const int failed = sodium_hex2bin(key.data(), key.size(), digits.data(), digits.size(), nullptr, &n, &end);
  const bool is_whole = failed == 0 && n == key.size() && end == digits.data() + digits.size();
  return is_whole ? std::optional(key) : std::nullopt;
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

bool is_signed_by(const PublicKey& key, std::span<const uint8_t> message, std::span<const uint8_t> signature) {
  return signature.size() == crypto_sign_BYTES &&
         crypto_sign_verify_detached(signature.data(), message.data(), message.size(), key.data()) == 0;
}

}  // namespace

std::string sha256(std::span<const uint8_t> bytes) {
  std::array<uint8_t, crypto_hash_sha256_BYTES> hash{};
  crypto_hash_sha256(hash.data(), bytes.data(), bytes.size());
  return {hash.begin(), hash.end()};
}

Result<KeyRing> KeyRing::load(const std::string& folder, bool accepts_development_key) {
  KeyRing ring;
  std::error_code failed;
  for (const auto& entry : std::filesystem::directory_iterator(folder, failed)) {
    if (entry.path().extension() != ".pub") continue;
    std::string digits;
    std::error_code unknown;  // opening a pipe would block
    if (entry.is_regular_file(unknown)) std::ifstream(entry.path()) >> std::setw(kMaxDigits) >> digits;
    const std::optional<PublicKey> key = parse_key(digits);
    if (!key) {
      return Error{ErrorKind::kBadInput, entry.path().string() + ": no public key of 64 hexadecimal digits: enrol it " +
                                             "again with `ruffini key enrol`, or remove it"};
    }
    ring.enrolled_.push_back(*key);
  }
  if (failed) {
    return Error{ErrorKind::kUnavailable, folder + ": the folder of keys cannot be read: " + failed.message()};
  }
  ring.accepts_development_key_ = accepts_development_key || ring.enrolled_.empty();
  return ring;
}

bool KeyRing::is_signed_by_enrolled(std::span<const uint8_t> message, std::span<const uint8_t> signature) const {
  return sodium_init() >= 0 && std::any_of(enrolled_.begin(), enrolled_.end(),
                                           [&](const PublicKey& key) { return is_signed_by(key, message, signature); });
}

std::vector<std::string> KeyRing::enrolled_ids() const {
  std::vector<std::string> ids;
  for (const PublicKey& key : enrolled_) ids.push_back(key_id(key));
  return ids;
}

Result<Signer> KeyRing::verify(const Calibration& calibration) const {
  if (sodium_init() < 0) return Error{ErrorKind::kUnavailable, "libsodium does not start: check its installation"};
  static const PublicKey kDevelopment = development_key();
  const auto fits = [&](const PublicKey& key) {
    return is_signed_by(key, calibration.signed_bytes(), calibration.signature());
  };
  const auto found = std::find_if(enrolled_.begin(), enrolled_.end(), fits);
  if (found != enrolled_.end()) return Signer{key_id(*found), false};
  if (accepts_development_key_ && fits(kDevelopment)) return Signer{key_id(kDevelopment), true};
  return Error{ErrorKind::kRefused, "the calibration's signature fits no key of this device (the file names key " +
                                        std::string(calibration.text("key_id")) +
                                        "): it was changed, or signed with a key that is not enrolled here"};
}

}  // namespace ruffini
