// What an EEPROM says its board, or its gel cartridge, is.
//
// Bytes, little endian: "RFID", version u8 = 1, kind u8 (1 board, 2 gel), n u16, n bytes of entries, CRC-32C u32 of all
// before it. An entry: tag u8, length u8, text of printable ASCII; 1 serial, 2 name, 3 revision, 4 made. Unknown tags
// are passed over. A serial of 1 to 23 letters, digits, - _ . is always there. At most 256 bytes in all.
// `ruffini board eeprom` reads and writes it.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "base/result.h"
#include "hw/i2c.h"

namespace ruffini {

enum class IdentityKind : uint8_t { kBoard = 1, kGel = 2 };

struct Identity {
  std::string serial;
  std::string name;      // of a board: its folder's; of a gel: its type
  std::string revision;  // may be empty, as `name` and `made`
  std::string made;
};

inline constexpr size_t kMaxIdentityBytes = 256;

// Errors: kBadInput, of bytes that are not exactly that; the sentence does not say where they came from.
[[nodiscard]] Result<Identity> parse_identity(std::span<const uint8_t> bytes, IdentityKind kind);

// Errors: kUnavailable (nobody answers), kBadInput (no identity of this kind), both with bus, address and remedy.
[[nodiscard]] Result<Identity> read_identity(I2cBus& bus, uint8_t address, int address_bytes, IdentityKind kind);

}  // namespace ruffini
