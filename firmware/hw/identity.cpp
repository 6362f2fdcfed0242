#include "hw/identity.h"

#include <algorithm>
#include <cstring>

#include "base/crc32c.h"

namespace ruffini {
namespace {

constexpr char kMagic[] = {'R', 'F', 'I', 'D'};
constexpr size_t kHeaderBytes = 8;
constexpr size_t kCrcBytes = 4;
constexpr uint8_t kVersion = 1;
constexpr size_t kMaxSerial = 23;

Error bad(const char* what) { return {ErrorKind::kBadInput, what}; }

bool is_serial(const std::string& text) {
  return !text.empty() && text.size() <= kMaxSerial && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '-' || c == '_' ||
           c == '.';
  }) && text.front() != '.';
}

// Total size of an identity according to its header; 0: no header.
size_t whole_bytes(std::span<const uint8_t> bytes) {
  if (bytes.size() < kHeaderBytes || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0) return 0;
  const size_t n = size_t{bytes[6]} + (size_t{bytes[7]} << 8) + kHeaderBytes + kCrcBytes;
  return n <= kMaxIdentityBytes ? n : 0;
}

}  // namespace

Result<Identity> parse_identity(std::span<const uint8_t> bytes, IdentityKind kind) {
  const size_t n = whole_bytes(bytes);
  if (n == 0 || bytes.size() < n) return bad("holds no identity");
  uint32_t crc = 0;
  for (size_t i = 0; i < kCrcBytes; ++i) crc |= uint32_t{bytes[n - kCrcBytes + i]} << (8 * i);
  if (crc32c(bytes.first(n - kCrcBytes)) != crc) return bad("holds a damaged identity (its checksum is wrong)");
  if (bytes[4] != kVersion) return bad("holds an identity of a version that is not known");
  if (bytes[5] != static_cast<uint8_t>(kind)) return bad("holds an identity of another kind");
  Identity identity;
  std::string* const texts[] = {&identity.serial, &identity.name, &identity.revision, &identity.made};
  std::span<const uint8_t> rest = bytes.subspan(kHeaderBytes, n - kHeaderBytes - kCrcBytes);
  while (!rest.empty()) {
    if (rest.size() < 2 || rest.size() - 2 < rest[1]) return bad("holds an identity whose entries are cut short");
    const auto text = rest.subspan(2, rest[1]);
    const size_t tag = rest[0];
    if (tag >= 1 && tag <= std::size(texts)) {
      if (!std::all_of(text.begin(), text.end(), [](uint8_t c) { return c >= ' ' && c <= '~'; })) {
        return bad("holds an identity that is no printable text");
      }
      texts[tag - 1]->assign(text.begin(), text.end());
    }
    rest = rest.subspan(2 + text.size());
  }
  if (!is_serial(identity.serial)) return bad("holds an identity without a proper serial number");
  return identity;
}

Result<Identity> read_identity(I2cBus& bus, uint8_t address, int address_bytes, IdentityKind kind) {
  const char* const what = kind == IdentityKind::kBoard ? "the board's EEPROM" : "the gel's EEPROM";
  const auto told = [&](const Error& error, const char* remedy) {
    return Error{error.kind, std::string(what) + ": " + error.message + remedy};
  };
  auto bytes = read_eeprom(bus, address, address_bytes, kHeaderBytes);
  if (!bytes) return told(bytes.error(), "");
  if (const size_t n = whole_bytes(bytes.value()); n != 0) {
    bytes = read_eeprom(bus, address, address_bytes, n);
    if (!bytes) return told(bytes.error(), "");
  }
  const auto identity = parse_identity(bytes.value(), kind);
  if (identity) return identity;
  return told(identity.error(), ": write one with `ruffini board eeprom write`");
}

}  // namespace ruffini
