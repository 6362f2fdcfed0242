// Replaces output_line.cpp in a wheel's ruffinid, which brings no libgpiod.
#include "hw/output_line.h"

namespace ruffini {

Result<std::unique_ptr<OutputLine>> open_output_line(const std::string& chip, const std::string& name) {
  return Error{ErrorKind::kUnavailable, "gpio: line \"" + name + "\" of " + chip +
                                            ": the ruffinid of a wheel has no GPIO: use the Debian package, or build "
                                            "ruffinid on the board"};
}

}  // namespace ruffini
