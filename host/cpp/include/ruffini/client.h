// C++ client for a ruffini sensor: takes the bytes of its serial port and returns forces in newtons. The README of
// host/cpp has an example. Standard library only, no thread, no system call: the caller reads the port.
#pragma once

#include "ruffini/client/damage_watch.h"  // IWYU pragma: export
#include "ruffini/client/decoder.h"       // IWYU pragma: export
#include "ruffini/client/encoder.h"       // IWYU pragma: export
#include "ruffini/client/messages.h"      // IWYU pragma: export
