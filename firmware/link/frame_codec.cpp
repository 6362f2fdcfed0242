#include "link/frame_codec.h"

#include <algorithm>
#include <cstring>

#include "base/crc32c.h"

namespace ruffini {
namespace {

constexpr size_t kCrcBytes = 4;

void put_u16(uint8_t* out, uint16_t v) {
  out[0] = static_cast<uint8_t>(v);
  out[1] = static_cast<uint8_t>(v >> 8);
}

void put_u32(uint8_t* out, uint32_t v) {
  put_u16(out, static_cast<uint16_t>(v));
  put_u16(out + 2, static_cast<uint16_t>(v >> 16));
}

uint32_t get_u32(const uint8_t* in) {
  return uint32_t{in[0]} | uint32_t{in[1]} << 8 | uint32_t{in[2]} << 16 | uint32_t{in[3]} << 24;
}

// Consistent overhead byte stuffing: each zero becomes the distance to the next one.
size_t cobs_encode(std::span<const uint8_t> in, uint8_t* out) {
  size_t code_at = 0;
  size_t at = 1;
  uint8_t code = 1;
  for (const uint8_t byte : in) {
    if (byte != 0) {
      out[at++] = byte;
      ++code;
    }
    if (byte == 0 || code == 0xFF) {
      out[code_at] = code;
      code_at = at++;
      code = 1;
    }
  }
  out[code_at] = code;
  return at;
}

// Returns the number of decoded bytes; nullopt if `in` is not valid COBS. Precondition: no byte of `in` is zero (zeros
// end frames).
std::optional<size_t> cobs_decode(std::span<const uint8_t> in, uint8_t* out) {
  size_t at = 0;
  size_t i = 0;
  while (i < in.size()) {
    const uint8_t code = in[i++];
    if (i + code - 1 > in.size()) return std::nullopt;
    for (uint8_t k = 1; k < code; ++k) out[at++] = in[i++];
    if (code != 0xFF && i < in.size()) out[at++] = 0;
  }
  return at;
}

}  // namespace

size_t encode_frame(const FrameHeader& header, std::span<const uint8_t> payload,
                    std::span<uint8_t, kMaxFrameBytes> out) {
  std::array<uint8_t, kHeaderBytes + kMaxPayloadBytes + kCrcBytes> raw;
  raw[0] = kProtocolVersion;
  raw[1] = header.flags;
  raw[2] = header.type;
  raw[3] = header.sensor;
  put_u32(&raw[4], header.sequence);
  raw[8] = header.fragment;
  raw[9] = header.n_fragments;
  put_u16(&raw[10], static_cast<uint16_t>(payload.size()));
  if (!payload.empty()) std::memcpy(&raw[kHeaderBytes], payload.data(), payload.size());
  const size_t n = kHeaderBytes + payload.size();
  put_u32(&raw[n], crc32c({raw.data(), n}));
  const size_t n_encoded = cobs_encode({raw.data(), n + kCrcBytes}, out.data());
  out[n_encoded] = 0;
  return n_encoded + 1;
}

std::optional<WireFrame> FrameDecoder::push(uint8_t byte) {
  if (byte == 0) {
    const bool was_oversize = is_oversize_;
    is_oversize_ = false;
    std::optional<WireFrame> frame;
    if (!was_oversize && n_encoded_ > 0) frame = finish();
    n_encoded_ = 0;
    return frame;
  }
  if (is_oversize_) return std::nullopt;
  if (n_encoded_ == kMaxFrameBytes - 1) {
    ++counters_.oversize;
    is_oversize_ = true;
    return std::nullopt;
  }
  encoded_[n_encoded_++] = byte;
  return std::nullopt;
}

std::optional<WireFrame> FrameDecoder::finish() {
  const std::optional<size_t> n = cobs_decode({encoded_.data(), n_encoded_}, decoded_.data());
  if (!n || *n < kHeaderBytes + kCrcBytes) {
    ++counters_.malformed;
    return std::nullopt;
  }
  const size_t n_body = *n - kCrcBytes;
  if (crc32c({decoded_.data(), n_body}) != get_u32(&decoded_[n_body])) {
    ++counters_.bad_crc;
    return std::nullopt;
  }
  const auto n_payload = static_cast<size_t>(decoded_[10] | decoded_[11] << 8);
  WireFrame frame{{decoded_[1], decoded_[2], decoded_[3], get_u32(&decoded_[4]), decoded_[8], decoded_[9]},
                  {decoded_.data() + kHeaderBytes, n_payload}};
  const bool is_known = decoded_[0] == kProtocolVersion && (frame.header.flags & ~kKnownFlags) == 0;
  if (!is_known || n_payload != n_body - kHeaderBytes || n_payload > kMaxPayloadBytes ||
      frame.header.n_fragments == 0 || frame.header.fragment >= frame.header.n_fragments) {
    ++counters_.malformed;
    return std::nullopt;
  }
  return frame;
}

}  // namespace ruffini
