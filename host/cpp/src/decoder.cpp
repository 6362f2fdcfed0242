#include "ruffini/client/decoder.h"

#include <cstring>
#include <utility>

#include "framing.h"
#include "reader.h"

namespace ruffini::client {
namespace {

constexpr uint32_t kRestartGap = 1U << 31;  // a sequence that goes back: the device was started again, nothing was lost

}  // namespace

std::vector<Packet> Decoder::feed(const uint8_t* bytes, size_t n_bytes) {
  std::vector<Packet> packets;
  feed(bytes, n_bytes, [&](Packet&& packet) { packets.push_back(std::move(packet)); });
  return packets;
}

void Decoder::feed(const uint8_t* bytes, size_t n_bytes, const std::function<void(Packet&&)>& on_packet) {
  while (n_bytes > 0) {
    const void* zero = std::memchr(bytes, 0, n_bytes);
    const size_t n = zero != nullptr ? static_cast<size_t>(static_cast<const uint8_t*>(zero) - bytes) : n_bytes;
    if (n > encoded_.size() - 1 - n_encoded_ && !is_oversize_) {
      ++counters_.oversize;
      is_oversize_ = true;
    }
    if (!is_oversize_) {
      std::memcpy(&encoded_[n_encoded_], bytes, n);
      n_encoded_ += n;
    }
    if (zero == nullptr) return;
    bytes += n + 1;
    n_bytes -= n + 1;
    std::optional<Packet> packet;
    if (!is_oversize_ && n_encoded_ > 0) packet = finish_frame();
    is_oversize_ = false;
    n_encoded_ = 0;
    if (packet) on_packet(std::move(*packet));
  }
}

std::optional<Packet> Decoder::finish_frame() {
  const auto n = cobs_decode(encoded_.data(), n_encoded_, decoded_.data());
  if (!n || *n < kHeaderBytes + kCrcBytes) {
    ++counters_.malformed;
    return std::nullopt;
  }
  const uint8_t* d = decoded_.data();
  const size_t n_body = *n - kCrcBytes;
  if (crc32c(d, n_body) != get_u32(d + n_body)) {
    ++counters_.bad_crc;
    return std::nullopt;
  }
  const Header header{d[1], d[2], d[3], d[9], get_u32(d + 4)};
  const size_t n_payload = d[10] | static_cast<size_t>(d[11]) << 8;
  if (d[0] != kProtocolVersion || (header.flags & ~kKnownFlags8) != 0 || n_payload != n_body - kHeaderBytes ||
      n_payload > kMaxPayloadBytes || d[8] >= header.n_fragments) {
    ++counters_.malformed;
    return std::nullopt;
  }
  if ((header.flags & kFromHost) != 0) {
    ++counters_.echo;
    return std::nullopt;
  }
  return assemble(header, d[8], d + kHeaderBytes, n_payload);
}

std::optional<Packet> Decoder::assemble(const Header& header, uint8_t fragment, const uint8_t* payload,
                                        size_t n_bytes) {
  if (fragment == 0) {
    if (open_) ++counters_.incomplete;
    open_ = header;
    n_fragments_ = 0;
    payload_.clear();
  } else if (!(open_ == header) || fragment != n_fragments_) {
    if (open_) ++counters_.incomplete;
    open_.reset();
    return std::nullopt;
  }
  payload_.insert(payload_.end(), payload, payload + n_bytes);
  ++n_fragments_;
  if (n_fragments_ < header.n_fragments) return std::nullopt;
  open_.reset();
  count_lost(header);
  Packet packet;
  packet.type = static_cast<Type>(header.type);
  packet.sensor = header.sensor;
  packet.sequence = header.sequence;
  packet.is_simulated = (header.flags & kSimulated) != 0;
  packet.is_replay = (header.flags & kReplay) != 0;
  packet.payload = payload_;
  if (!read_message(packet.type, packet.payload, packet.message)) {
    ++counters_.undecodable;
    packet.message = std::monostate();
  }
  return packet;
}

void Decoder::count_lost(const Header& header) {
  auto& last = last_[header.sensor];
  const uint32_t missing = last ? header.sequence - *last - 1 : 0;
  if (missing < kRestartGap) counters_.lost += missing;
  last = header.sequence;
}

}  // namespace ruffini::client
