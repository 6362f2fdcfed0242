// Frames on the wire: header, payload, CRC-32C, COBS, 0x00. Byte for byte: proto/README.md.
// No system call, no allocation, no floating point; reentrant.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

namespace ruffini {

inline constexpr uint8_t kProtocolVersion = 1;
inline constexpr size_t kHeaderBytes = 12;
inline constexpr size_t kMaxPayloadBytes = 4048;
inline constexpr size_t kMaxFragments = 255;    // a message: at most 1,032,240 bytes
inline constexpr size_t kMaxFrameBytes = 4096;  // encoded, with the delimiter

enum FrameFlag : uint8_t { kFromHost = 1, kSimulated = 2, kReplay = 4, kKnownFlags = 7 };

struct FrameHeader {
  uint8_t flags = 0;
  uint8_t type = 0;
  uint8_t sensor = 0;
  uint32_t sequence = 0;
  uint8_t fragment = 0;
  uint8_t n_fragments = 1;
};

struct WireFrame {
  FrameHeader header;
  std::span<const uint8_t> payload;
};

// Encodes one frame into `out` (kMaxFrameBytes); returns the number of bytes, delimiter included.
// Precondition: payload.size() <= kMaxPayloadBytes.
size_t encode_frame(const FrameHeader& header, std::span<const uint8_t> payload,
                    std::span<uint8_t, kMaxFrameBytes> out);

// Reasons for discarding received bytes.
struct DecoderCounters {
  uint64_t bad_crc = 0;
  uint64_t malformed = 0;  // COBS, length, version, unknown flags, fragment numbers
  uint64_t oversize = 0;
};

// Byte-fed; holds at most one frame. A returned frame is valid until the next push.
class FrameDecoder {
 public:
  std::optional<WireFrame> push(uint8_t byte);
  [[nodiscard]] const DecoderCounters& counters() const { return counters_; }

 private:
  std::optional<WireFrame> finish();

  std::array<uint8_t, kMaxFrameBytes> encoded_{};
  std::array<uint8_t, kMaxFrameBytes> decoded_{};
  size_t n_encoded_ = 0;
  bool is_oversize_ = false;
  DecoderCounters counters_;
};

}  // namespace ruffini
