#include <gtest/gtest.h>

#include "hw/output_line.h"

namespace ruffini {
namespace {

TEST(NoOutputLine, NamesTheLineAndTheRemedy) {
  const auto line = open_output_line("gpiochip0", "LAMPS");
  ASSERT_FALSE(line);
  EXPECT_EQ(line.error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(line.error().message,
            "gpio: line \"LAMPS\" of gpiochip0: the ruffinid of a wheel has no GPIO: use the Debian package, or build "
            "ruffinid on the board");
}

}  // namespace
}  // namespace ruffini
