// Decodes the bytes of a sensor's line to typed messages. No input can crash the decoder; damaged data is counted.
// Limits: 4 million values a grid, 64 contacts, 16 sensors. Memory stays below 100 MB if feed() is called with a
// callback, or with some kB at a time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <variant>
#include <vector>

#include "ruffini/client/messages.h"

namespace ruffini::client {

// MessageType of ruffini.proto.
enum class Type : uint8_t {
  kHello = 1,
  kSchema = 2,
  kStatus = 3,
  kWrench = 4,
  kField = 5,
  kDepth = 6,
  kContacts = 7,
  kMarkers = 8,
  kImage = 9,
  kEvent = 10,
  kCommand = 11,
  kReply = 12,
  kLearned = 13,
  kTime = 14,
  kSignedCommand = 15,
  kResidual = 16,
  kFeatures = 17,
};

// std::monostate: a type that this library does not decode, or a payload that does not match ruffini.proto.
using Message = std::variant<std::monostate, Hello, Status, Wrench, Field, Depth, Contacts, Event, Reply, Time,
                             Residual, Markers, Learned>;

struct Packet {
  Type type{};
  uint8_t sensor = 0;  // 255: the device itself
  uint32_t sequence = 0;
  bool is_simulated = false;  // derived from a simulated camera
  bool is_replay = false;     // derived from a recording
  Message message;
  std::vector<uint8_t> payload;  // protobuf (ruffini.proto), also with the fields that Message lacks
};

// Counts of discarded data by reason, and of missing messages.
struct Counters {
  uint64_t bad_crc = 0;
  uint64_t malformed = 0;    // COBS, length, version, flags, fragment numbers
  uint64_t oversize = 0;     // 4,096 bytes without a delimiter
  uint64_t incomplete = 0;   // messages with missing fragments
  uint64_t undecodable = 0;  // complete, but not valid by ruffini.proto
  uint64_t echo = 0;         // frames of this host, returned by the line
  uint64_t lost = 0;         // missing sequence numbers: lost on the line or dropped at the device

  // Frames damaged on the line.
  [[nodiscard]] uint64_t damaged() const { return bad_crc + malformed + oversize; }
};

class Decoder {
 public:
  // Calls on_packet for each message that these bytes complete, in order.
  void feed(const uint8_t* bytes, size_t n_bytes, const std::function<void(Packet&&)>& on_packet);
  // As above, but returns the messages.
  std::vector<Packet> feed(const uint8_t* bytes, size_t n_bytes);

  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  // Header fields that all fragments of a message share.
  struct Header {
    uint8_t flags = 0, type = 0, sensor = 0, n_fragments = 0;
    uint32_t sequence = 0;
    bool operator==(const Header& o) const {
      return flags == o.flags && type == o.type && sensor == o.sensor && n_fragments == o.n_fragments &&
             sequence == o.sequence;
    }
  };
  std::optional<Packet> finish_frame();
  std::optional<Packet> assemble(const Header& header, uint8_t fragment, const uint8_t* payload, size_t n_bytes);
  void count_lost(const Header& header);

  std::array<uint8_t, 4096> encoded_{};
  std::array<uint8_t, 4096> decoded_{};
  size_t n_encoded_ = 0;
  bool is_oversize_ = false;
  std::optional<Header> open_;
  uint8_t n_fragments_ = 0;  // received fragments of the open message
  std::vector<uint8_t> payload_;
  std::array<std::optional<uint32_t>, 256> last_;  // last sequence number of each sensor
  Counters counters_;
};

}  // namespace ruffini::client
