// Serial number for a device without one in its options or EEPROM: drawn once and stored, so that two daemons on one
// computer, or two boards with the same image, differ.
#pragma once

#include <string>

#include "base/random.h"

namespace ruffini {

// Returns the number stored in `folder`, or draws and stores one. Returns "0000" if the folder cannot be written.
[[nodiscard]] std::string own_serial(const std::string& folder, Random& random);

}  // namespace ruffini
