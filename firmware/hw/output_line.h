// One output line of a GPIO chip, through libgpiod 2.
#pragma once

#include <memory>
#include <string>

#include "base/result.h"

namespace ruffini {

class OutputLine {
 public:
  virtual ~OutputLine() = default;
  // Returns false if the line can no longer be set.
  [[nodiscard]] virtual bool set(bool is_on) = 0;
};

// `chip`: "gpiochip0" or a path. `name`: name of the line in the board's device tree. Initially off. Errors:
// kUnavailable (no such chip, no such line, in use).
[[nodiscard]] Result<std::unique_ptr<OutputLine>> open_output_line(const std::string& chip, const std::string& name);

}  // namespace ruffini
