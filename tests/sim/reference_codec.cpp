#include "reference_codec.h"

namespace ruffini::sim {
namespace {

constexpr size_t kHeader = 12;
constexpr size_t kCrc = 4;
constexpr size_t kMaxEncoded = 4'095;  // without the delimiter
constexpr size_t kLongestRun = 254;

uint32_t crc32c(std::span<const uint8_t> bytes) {
  static const std::array<uint32_t, 256> kTable = [] {
    std::array<uint32_t, 256> table{};
    for (uint32_t i = 0; i < 256; ++i) {
      uint32_t c = i;
      for (int bit = 0; bit < 8; ++bit) c = (c & 1) != 0 ? c >> 1 ^ 0x82F6'3B78U : c >> 1;
      table[i] = c;
    }
    return table;
  }();
  uint32_t crc = UINT32_MAX;
  for (const uint8_t byte : bytes) crc = kTable[(crc ^ byte) & 255] ^ crc >> 8;
  return ~crc;
}

uint32_t little(std::span<const uint8_t> bytes) {
  return static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
         static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

std::optional<std::vector<uint8_t>> unstuffed(const std::vector<uint8_t>& encoded) {
  std::vector<uint8_t> out;
  for (size_t at = 0; at < encoded.size();) {
    const size_t n = encoded[at] - size_t{1};
    if (at + 1 + n > encoded.size()) return std::nullopt;
    out.insert(out.end(), encoded.begin() + static_cast<ptrdiff_t>(at + 1),
               encoded.begin() + static_cast<ptrdiff_t>(at + 1 + n));
    at += 1 + n;
    if (n != kLongestRun && at < encoded.size()) out.push_back(0);
  }
  return out;
}

}  // namespace

std::vector<uint8_t> reference_frame(uint8_t type, std::span<const uint8_t> payload, uint32_t sequence) {
  std::vector<uint8_t> plain = {1, 1, type, 255};
  for (int shift = 0; shift < 32; shift += 8) plain.push_back(static_cast<uint8_t>(sequence >> shift));
  plain.insert(plain.end(), {0, 1, static_cast<uint8_t>(payload.size()), static_cast<uint8_t>(payload.size() >> 8)});
  plain.insert(plain.end(), payload.begin(), payload.end());
  const uint32_t crc = crc32c(plain);
  for (int shift = 0; shift < 32; shift += 8) plain.push_back(static_cast<uint8_t>(crc >> shift));
  std::vector<uint8_t> out;
  for (size_t begin = 0; begin <= plain.size();) {
    size_t end = begin;
    while (end < plain.size() && end - begin < kLongestRun && plain[end] != 0) ++end;
    out.push_back(static_cast<uint8_t>(end - begin + 1));
    out.insert(out.end(), plain.begin() + static_cast<ptrdiff_t>(begin), plain.begin() + static_cast<ptrdiff_t>(end));
    begin = end - begin == kLongestRun ? end : end + 1;  // a full run has no zero after it
  }
  out.push_back(0);
  return out;
}

std::optional<ReferenceFrame> ReferenceDecoder::push(uint8_t byte, uint64_t now_us) {
  if (byte != 0) {
    if (encoded_.empty()) begun_us_ = now_us;
    if (encoded_.size() >= kMaxEncoded) {
      is_oversize_ = true;
    } else {
      encoded_.push_back(byte);
    }
    return std::nullopt;
  }
  const bool is_empty = encoded_.empty();
  const auto plain = is_oversize_ ? std::nullopt : unstuffed(encoded_);
  encoded_.clear();
  is_oversize_ = false;
  if (is_empty) return std::nullopt;
  ++n_damaged_;  // until it is known to be whole
  if (!plain || plain->size() < kHeader + kCrc) return std::nullopt;
  const std::span<const uint8_t> all = *plain;
  const auto checked = all.first(all.size() - kCrc);
  if (crc32c(checked) != little(all.last(kCrc))) return std::nullopt;
  const size_t n_payload = all[10] | static_cast<size_t>(all[11]) << 8;
  const bool is_known = all[0] == 1 && (all[1] & ~7) == 0 && all[8] < all[9] && n_payload == checked.size() - kHeader;
  if (!is_known) return std::nullopt;
  --n_damaged_;
  const auto payload = checked.subspan(kHeader);
  return ReferenceFrame{
      all[1], all[2], all[3], little(all.subspan(4)), all[8], all[9], {payload.begin(), payload.end()}, begun_us_};
}

}  // namespace ruffini::sim
