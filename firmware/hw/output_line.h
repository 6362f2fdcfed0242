// One output line of a GPIO chip, by the kernel's own interface (linux/gpio.h, version 2): what libgpiod 1 and 2 of the two
// Debian releases have in common.
#pragma once

#include <memory>
#include <string>

#include "base/result.h"

namespace ruffini {

class OutputLine {
 public:
  virtual ~OutputLine() = default;
  // False: the line cannot be set any more.
  [[nodiscard]] virtual bool set(bool is_on) = 0;
};

// `chip`: "gpiochip0" or a path; `name`: of the line, as the board's device tree calls it. Off at first.
// Errors: kUnavailable (no such chip, no such line, in use).
[[nodiscard]] Result<std::unique_ptr<OutputLine>> open_output_line(const std::string& chip, const std::string& name);

}  // namespace ruffini
