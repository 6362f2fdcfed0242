// A file put in force at once, as after a trial that went well.
#pragma once

#include <cstdint>
#include <span>

#include "store/slot_store.h"

namespace ruffini::test {

inline Status install(SlotStore& store, std::span<const uint8_t> bytes) {
  Status done = store.stage(bytes);
  return done ? store.confirm() : done;
}

}  // namespace ruffini::test
