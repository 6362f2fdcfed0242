// Encodes a host's messages to a sensor. Each call returns the bytes to write to the port.
#pragma once

#include <cstdint>
#include <string_view>
#include <utility>
#include <vector>

#include "ruffini/client/decoder.h"

namespace ruffini::client {

using Bytes = std::vector<uint8_t>;

class Encoder {
 public:
  // `holder`: a number above 0, drawn at random at each start. The device (a daemon with its sensors) identifies hosts
  // by it, and accepts changes from one host at a time. Write the bytes of ask_hello() first: they also end a frame
  // that a previous host left incomplete.
  explicit Encoder(uint32_t holder) : holder_(holder) {}

  Bytes ask_hello();
  Bytes ask_status();
  Bytes ask_time(uint64_t token);
  // Subscribes to every n-th frame's message of each type, e.g. {{Type::kWrench, 1}, {Type::kField, 4}}. STATUS comes
  // once a second for any n above 0. More than 16 types get no Reply. Replaces the previous subscription.
  Bytes subscribe(const std::vector<std::pair<Type, uint32_t>>& every);
  // Learns the rest image of the untouched pad again from n_frames, at most 256; 0: as many as board.toml says. The
  // reply is REFUSED if the pad is touched, unless even_if_touched is set. OK means that learning begins: README.md.
  Bytes zero(uint32_t n_frames = 0, bool even_if_touched = false, uint8_t sensor = kDevice);

  // Id of the last subscribe() or zero(); the Reply repeats it. If no Reply arrives within 0.5 s, write the same bytes
  // again.
  [[nodiscard]] uint32_t request_id() const { return request_id_; }

  static constexpr uint8_t kDevice = 255;

 private:
  Bytes command(const Bytes& action, uint8_t sensor);
  Bytes frame(Type type, const Bytes& payload, uint8_t sensor);

  uint32_t holder_;
  uint32_t sequence_ = 0;
  uint32_t request_id_ = 0;
};

}  // namespace ruffini::client
