// Serial number of a device without one in its options or EEPROM: drawn once and kept in the store, so that two daemons on
// one computer, or two boards with the same image, have different numbers.
#pragma once

#include <string>

#include "base/random.h"

namespace ruffini {

// Returns the number that `folder` keeps, or draws one and keeps it. "0000" if the folder cannot be written.
[[nodiscard]] std::string own_serial(const std::string& folder, Random& random);

}  // namespace ruffini
