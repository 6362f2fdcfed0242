// The door of libruffini_infer.so: a library of its own, so that boards without a network need no OpenCV dnn.
#pragma once

#include "infer/network.h"

namespace ruffini {

inline constexpr const char* kNetworkLibrary = "libruffini_infer.so";
inline constexpr const char* kNetworkOpener = "ruffini_open_network";

// The caller owns what is returned; nullptr where the file cannot be run.
using NetworkOpener = Network*(const char* path);

}  // namespace ruffini
