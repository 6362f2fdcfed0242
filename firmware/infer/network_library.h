// Entry point of libruffini_infer.so, a separate library so that boards without a network need no OpenCV dnn.
#pragma once

#include "infer/network.h"

namespace ruffini {

inline constexpr const char* kNetworkLibrary = "libruffini_infer.so";
inline constexpr const char* kNetworkOpener = "ruffini_open_network";

// The caller owns the result; nullptr if the file cannot be run.
using NetworkOpener = Network*(const char* path);

}  // namespace ruffini
