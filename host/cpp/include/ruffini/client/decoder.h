// Bytes of a sensor's line to typed messages. Whatever comes: no crash, no more than 70 MB, and what is damaged is counted.
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
  kResidual = 16,
};

// std::monostate: a type that this library does not read, or a payload that is not what ruffini.proto says.
using Message = std::variant<std::monostate, Hello, Status, Wrench, Field, Depth, Contacts, Event, Reply, Time,
                             Residual, Markers, Learned>;

struct Packet {
  Type type{};
  uint8_t sensor = 0;  // 255: the device itself
  uint32_t sequence = 0;
  bool is_simulated = false;  // rests on a simulated camera
  bool is_replay = false;     // rests on a recording
  Message message;
  std::vector<uint8_t> payload;  // protobuf, as ruffini.proto says: for the fields that are not in Message
};

// Why something was thrown away, and what never came.
struct Counters {
  uint64_t bad_crc = 0;
  uint64_t malformed = 0;    // COBS, length, version, flags, fragment numbers
  uint64_t oversize = 0;     // 4,096 bytes without an end
  uint64_t incomplete = 0;   // messages whose fragments did not all come
  uint64_t undecodable = 0;  // whole, and not what ruffini.proto says
  uint64_t echo = 0;         // what this host said itself
  uint64_t lost = 0;         // messages by their sequence numbers
};

class Decoder {
 public:
  // Calls on_packet for each message that these bytes complete, in order.
  void feed(const uint8_t* bytes, size_t n_bytes, const std::function<void(Packet&&)>& on_packet);
  // The same, collected.
  std::vector<Packet> feed(const uint8_t* bytes, size_t n_bytes);

  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  // A message in parts: those that differ in any of these are not of one message.
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
  uint8_t n_fragments_ = 0;  // of the open message that came
  std::vector<uint8_t> payload_;
  std::array<std::optional<uint32_t>, 256> last_;  // sequence by sensor
  Counters counters_;
};

}  // namespace ruffini::client
