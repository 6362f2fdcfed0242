#include "store/signature.h"

#include <gtest/gtest.h>
#include <sodium.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>

#include "support/calibration_bytes.h"
#include "support/signed_calibration.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

std::string hex(const std::string& bytes) {
  std::string out;
  for (const char c : bytes) {
    for (const int digit : {(c >> 4) & 15, c & 15}) out += "0123456789abcdef"[digit];
  }
  return out;
}

Bytes small_file() {
  return test::CalibrationBytes()
      .meta("kinds", "rest")
      .meta("key_id", "c72ea612")
      .tensor("rest.image", "U8", {8}, Bytes{1, 2, 3, 4, 5, 6, 7, 8})
      .bytes();
}

// nullopt where the file cannot even be read.
std::optional<Result<Signer>> judge(const Bytes& bytes, const KeyRing& keys = KeyRing()) {
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  if (!bytes.empty()) std::memcpy(aligned.data(), bytes.data(), bytes.size());
  const auto parsed = Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), bytes.size()});
  if (!parsed) return std::nullopt;
  return keys.verify(parsed.value());
}

// FIPS 180-4, appendix B.
TEST(Sha256, KnownAnswers) {
  EXPECT_EQ(hex(sha256({})), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(hex(sha256(Bytes{'a', 'b', 'c'})), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Signature, TheDevelopmentKeyIsKnownAndNamed) {
  const auto signer = judge(test::sign(small_file()));
  ASSERT_TRUE(signer && *signer);
  EXPECT_EQ(signer->value().key_id, "c72ea612");
  EXPECT_TRUE(signer->value().is_development_key);
}

TEST(Signature, AnUnsignedFileIsRefusedWithTheKeyThatItNames) {
  const auto signer = judge(small_file());  // the signature is zeros
  ASSERT_TRUE(signer);
  ASSERT_FALSE(*signer);
  EXPECT_EQ(signer->error().kind, ErrorKind::kRefused);
  EXPECT_NE(signer->error().message.find("c72ea612"), std::string::npos) << signer->error().message;
}

TEST(Signature, EveryFlippedBitIsRefused) {
  Bytes bytes = test::sign(small_file());
  for (size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
    const auto flip = static_cast<uint8_t>(1U << bit % 8);
    bytes[bit / 8] ^= flip;
    const auto signer = judge(bytes);
    EXPECT_FALSE(signer && *signer) << "bit " << bit;
    bytes[bit / 8] ^= flip;
  }
  EXPECT_TRUE(judge(bytes) && *judge(bytes));
}

Bytes file_of_16_kib() {
  constexpr size_t kBytes = 16'384;
  const auto with = [](size_t n) {
    return test::CalibrationBytes()
        .meta("kinds", "rest")
        .tensor("rest.image", "U8", {static_cast<int>(n)}, Bytes(n, 0x35))
        .bytes();
  };
  const size_t n = kBytes - with(8'192).size() + 8'192;
  return test::sign(with(n));
}

// RUFFINI_SOAK: all 131,072 bits; else one of each byte.
TEST(Signature, OfATableOf16KibibytesEveryBitAndEveryLengthIsRefused) {
  Bytes bytes = file_of_16_kib();
  ASSERT_EQ(bytes.size(), 16'384U);
  ASSERT_TRUE(judge(bytes) && *judge(bytes));
  size_t n_bits = 0;
  const size_t step = std::getenv("RUFFINI_SOAK") != nullptr ? 1 : 9;  // 9 and not 8: each of the eight in its turn
  for (size_t bit = 0; bit < 8 * bytes.size(); bit += step) {
    const auto flip = static_cast<uint8_t>(1U << bit % 8);
    bytes[bit / 8] ^= flip;
    const auto signer = judge(bytes);
    ASSERT_FALSE(signer && *signer) << "bit " << bit;
    bytes[bit / 8] ^= flip;
    ++n_bits;
  }
  for (size_t n = 0; n <= bytes.size() + 64; ++n) {
    Bytes other = bytes;
    other.resize(n);
    const auto signer = judge(other);
    ASSERT_EQ(signer && *signer, n == bytes.size()) << n << " bytes";
  }
  std::printf("a table of 16 KiB: %zu flipped bits and %zu other lengths, all refused\n", n_bits, bytes.size() + 64);
}

TEST(Signature, AnotherKeysSignatureIsRefused) {
  Bytes bytes = small_file();
  std::array<uint8_t, crypto_sign_PUBLICKEYBYTES> public_key{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_key{};
  const std::array<uint8_t, crypto_sign_SEEDBYTES> seed{7};
  crypto_sign_seed_keypair(public_key.data(), secret_key.data(), seed.data());
  const size_t n_signed = bytes.size() - crypto_sign_BYTES;
  crypto_sign_detached(bytes.data() + n_signed, nullptr, bytes.data(), n_signed, secret_key.data());
  EXPECT_EQ(crypto_sign_verify_detached(bytes.data() + n_signed, bytes.data(), n_signed, public_key.data()), 0);
  const auto signer = judge(bytes);
  ASSERT_TRUE(signer);
  EXPECT_FALSE(*signer);
}

class KeyRingTest : public testing::Test {
 protected:
  KeyRingTest() { std::filesystem::create_directories(folder_); }
  ~KeyRingTest() override { std::filesystem::remove_all(folder_); }
  void enrol(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ + "/" + name) << text << "\n";
  }
  const std::string folder_ = testing::TempDir() + "key_ring_test" + std::to_string(::getpid());
};

// The owner's key: the seed is 32 times 7.
Bytes signed_by_owner(std::string& public_hex) {
  std::array<uint8_t, crypto_sign_SEEDBYTES> seed{};
  seed.fill(7);
  std::array<uint8_t, crypto_sign_PUBLICKEYBYTES> public_key{};
  std::array<uint8_t, crypto_sign_SECRETKEYBYTES> secret_key{};
  crypto_sign_seed_keypair(public_key.data(), secret_key.data(), seed.data());
  public_hex = hex({public_key.begin(), public_key.end()});
  Bytes file = small_file();
  const size_t n = file.size() - crypto_sign_BYTES;
  crypto_sign_detached(file.data() + n, nullptr, file.data(), n, secret_key.data());
  return file;
}

TEST_F(KeyRingTest, AnEnrolledKeyCountsAndTheDevelopmentKeyNoMore) {
  std::string public_hex;
  const Bytes owners = signed_by_owner(public_hex);
  const Bytes anybodys = test::sign(small_file());
  const auto nobodys = KeyRing::load(folder_, false);
  ASSERT_TRUE(nobodys);
  EXPECT_TRUE(nobodys.value().accepts_development_key()) << "else nothing could be flashed at all";
  EXPECT_FALSE(*judge(owners, nobodys.value()));
  enrol("owner.pub", public_hex);
  enrol("notes.txt", "no key");
  for (const bool is_asked : {false, true}) {
    const auto keys = KeyRing::load(folder_, is_asked);
    ASSERT_TRUE(keys);
    EXPECT_EQ(keys.value().accepts_development_key(), is_asked);
    const auto signer = judge(owners, keys.value());
    ASSERT_TRUE(*signer);
    EXPECT_FALSE(signer->value().is_development_key);
    EXPECT_EQ(judge(anybodys, keys.value())->has_value(), is_asked);
  }
  Bytes changed = owners;
  changed[changed.size() - crypto_sign_BYTES - 1] ^= 1;
  EXPECT_FALSE(*judge(changed, KeyRing::load(folder_, false).value()));
}

TEST_F(KeyRingTest, WhatIsNoKeyIsNamed) {
  for (const std::string& text :
       {std::string(), std::string(63, 'a'), std::string(65, 'a'), std::string(64, 'g'), std::string(62, 'a') + "zz"}) {
    enrol("spoilt.pub", text);
    const auto keys = KeyRing::load(folder_, true);
    ASSERT_FALSE(keys) << text;
    EXPECT_EQ(keys.error().kind, ErrorKind::kBadInput);
    EXPECT_NE(keys.error().message.find("spoilt.pub"), std::string::npos) << keys.error().message;
  }
  EXPECT_EQ(KeyRing::load(folder_ + "/nothing", true).error().kind, ErrorKind::kUnavailable);
}

}  // namespace
}  // namespace ruffini
