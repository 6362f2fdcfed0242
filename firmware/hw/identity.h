// Identity of a board or a gel cartridge, stored in an EEPROM.
//
// Bytes, little endian: "RFID", version u8 = 1, kind u8 (1 board, 2 gel), n u16, n bytes of entries, CRC-32C u32 of all
// preceding bytes. An entry: tag u8, length u8, printable ASCII text; 1 serial, 2 name, 3 revision, 4 made. Unknown
// tags are skipped. A serial of 1 to 23 letters, digits, - _ . is mandatory. At most 256 bytes in all. `ruffini board
// eeprom` reads and writes it.
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
  std::string name;      // for a board: name of its folder; for a gel: its type
  std::string revision;  // may be empty, as may `name` and `made`
  std::string made;
};

inline constexpr size_t kMaxIdentityBytes = 256;

// Returns kBadInput for any other bytes. The caller adds their origin to the message.
[[nodiscard]] Result<Identity> parse_identity(std::span<const uint8_t> bytes, IdentityKind kind);

// Errors: kUnavailable (no device answers), kBadInput (no identity of this kind), both with bus, address and remedy.
[[nodiscard]] Result<Identity> read_identity(I2cBus& bus, uint8_t address, int address_bytes, IdentityKind kind);

}  // namespace ruffini
