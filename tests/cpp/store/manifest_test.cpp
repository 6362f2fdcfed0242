#include "store/manifest.h"

#include <gtest/gtest.h>

#include <cstring>
#include <string>
#include <vector>

#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

Result<Manifest> manifest_of(test::CalibrationBytes file) {
  const std::vector<uint8_t> bytes =
      file.meta("kinds", "rest").tensor("rest.image", "U8", {8}, std::vector<uint8_t>(8)).bytes();
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  std::memcpy(aligned.data(), bytes.data(), bytes.size());
  const auto parsed = Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), bytes.size()});
  EXPECT_TRUE(parsed.has_value());
  return read_manifest(parsed.value());
}

test::CalibrationBytes stamped(const std::string& version, const std::string& epoch) {
  test::CalibrationBytes file;
  return std::move(file.meta("version", version).meta("security_epoch", epoch));
}

TEST(Manifest, IsReadFromTheSignedText) {
  const auto plain = manifest_of(stamped("7", "2"));
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain.value().version, 7);
  EXPECT_EQ(plain.value().epoch, 2U);
  EXPECT_FALSE(plain.value().allows_older || plain.value().allows_jump);
  const auto allowed = manifest_of(std::move(stamped("1", "0").meta("allow_older", "1").meta("allow_jump", "1")));
  EXPECT_TRUE(allowed.value().allows_older && allowed.value().allows_jump);
  const auto unsaid = manifest_of(std::move(stamped("1", "0").meta("allow_older", "0").meta("allow_jump", "yes")));
  EXPECT_FALSE(unsaid.value().allows_older || unsaid.value().allows_jump);
}

TEST(Manifest, NumbersThatAreNoneAreRefused) {
  EXPECT_FALSE(manifest_of(test::CalibrationBytes()));
  EXPECT_FALSE(manifest_of(std::move(test::CalibrationBytes().meta("version", "1"))));
  for (const char* odd : {"", "0", "-1", "1.0", " 1", "1000000000000", "99999999999999999999"}) {
    EXPECT_FALSE(manifest_of(stamped(odd, "0"))) << odd;
  }
  for (const char* odd : {"", "-1", "x", "1000000001", "4294967296"})
    EXPECT_FALSE(manifest_of(stamped("1", odd))) << odd;
}

TEST(Manifest, TheSecurityEpochNeverFalls) {
  EXPECT_TRUE(check_epoch({.version = 1, .epoch = 3}, 3));
  EXPECT_TRUE(check_epoch({.version = 1, .epoch = 4}, 3));
  EXPECT_FALSE(check_epoch({.version = 1, .epoch = 2}, 3));
  const Status refused = check_succession({.version = 9, .epoch = 2, .allows_older = true, .allows_jump = true}, 5, 3);
  ASSERT_FALSE(refused) << "no owner can allow it";
  EXPECT_EQ(refused.error().kind, ErrorKind::kRefused);
}

TEST(Manifest, AnOlderVersionNeedsItsOwnersWord) {
  EXPECT_TRUE(check_succession({.version = 5}, 5, 0)) << "the same again";
  EXPECT_TRUE(check_succession({.version = 6}, 5, 0));
  EXPECT_FALSE(check_succession({.version = 4}, 5, 0));
  EXPECT_TRUE(check_succession({.version = 4, .allows_older = true}, 5, 0));
}

// A huge number would lock out every file to come.
TEST(Manifest, NumbersFarAheadNeedTheirOwnersWord) {
  EXPECT_TRUE(check_succession({.version = 1'005, .epoch = 18}, 5, 2));
  EXPECT_FALSE(check_succession({.version = 1'006}, 5, 0));
  EXPECT_FALSE(check_succession({.version = 5, .epoch = 19}, 5, 2));
  EXPECT_FALSE(check_succession({.version = 1'001}, 0, 0)) << "nor where nothing is in force";
  EXPECT_TRUE(check_succession({.version = 1'006, .epoch = 19, .allows_jump = true}, 5, 2));
}

}  // namespace
}  // namespace ruffini
