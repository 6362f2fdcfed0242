// Reads a ruffini sensor from C++: bytes from its serial port in, newtons out. README.md in this folder has an example.
// Standard library only, no thread, no system call: where the bytes come from is up to you.
#pragma once

#include "ruffini/client/decoder.h"   // IWYU pragma: export
#include "ruffini/client/encoder.h"   // IWYU pragma: export
#include "ruffini/client/messages.h"  // IWYU pragma: export
