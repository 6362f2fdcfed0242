// The serial number of a device that nobody has given one: drawn once, kept in the store, so that two daemons on one
// computer, or two boards of one image, are told apart.
#pragma once

#include <string>

#include "base/random.h"

namespace ruffini {

// What `folder` keeps; drawn and kept where it keeps none. "0000" where the folder cannot be written.
[[nodiscard]] std::string own_serial(const std::string& folder, Random& random);

}  // namespace ruffini
