#include "store/huge_pages.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace ruffini {
namespace {

TEST(HugePages, AreZerosOfAnyLength) {
  for (const size_t n : {size_t{0}, size_t{1}, size_t{4'194'303}, size_t{4'194'304}, size_t{18'778'235}}) {
    std::vector<uint8_t> bytes = bytes_in_huge_pages(n);
    ASSERT_EQ(bytes.size(), n);
    EXPECT_EQ(static_cast<size_t>(std::count(bytes.begin(), bytes.end(), 0)), n);
    std::fill(bytes.begin(), bytes.end(), uint8_t{7});
    EXPECT_EQ(static_cast<size_t>(std::count(bytes.begin(), bytes.end(), 7)), n);
  }
}

}  // namespace
}  // namespace ruffini
