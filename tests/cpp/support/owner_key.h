// An owner's key for tests (its seed is 32 times 7), enrolled in a folder, and what it signs.
#pragma once

#include <sodium.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <vector>

#include "store/signature.h"

namespace ruffini::test {

class OwnerKey {
 public:
  explicit OwnerKey(uint8_t seed_byte = 7) {
    std::array<uint8_t, crypto_sign_SEEDBYTES> seed{};
    seed.fill(seed_byte);
    crypto_sign_seed_keypair(public_.data(), secret_.data(), seed.data());
  }
  [[nodiscard]] KeyRing enrolled_in(const std::string& folder) const {
    std::filesystem::create_directories(folder);
    std::array<char, 2 * crypto_sign_PUBLICKEYBYTES + 1> hex{};
    sodium_bin2hex(hex.data(), hex.size(), public_.data(), public_.size());
    std::ofstream(folder + "/owner.pub") << hex.data() << "\n";
    return KeyRing::load(folder, false).value();
  }
  [[nodiscard]] std::vector<uint8_t> sign(std::span<const uint8_t> message) const {
    std::vector<uint8_t> signature(crypto_sign_BYTES);
    crypto_sign_detached(signature.data(), nullptr, message.data(), message.size(), secret_.data());
    return signature;
  }
  // Of a command, as proto/ruffini.proto says.
  [[nodiscard]] std::vector<uint8_t> sign_command(const std::string& serial, std::span<const uint8_t> nonce,
                                                  uint32_t counter, uint8_t sensor,
                                                  std::span<const uint8_t> command) const {
    const std::string head = std::string("ruffini command 1") + '\0' + serial + '\0';
    std::vector<uint8_t> message(head.begin(), head.end());
    message.insert(message.end(), nonce.begin(), nonce.end());
    for (int i = 0; i < 4; ++i) message.push_back(static_cast<uint8_t>(counter >> (8 * i)));
    message.push_back(sensor);
    message.insert(message.end(), command.begin(), command.end());
    return sign(message);
  }

 private:
  std::array<uint8_t, crypto_sign_PUBLICKEYBYTES> public_{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_{};
};

}  // namespace ruffini::test
