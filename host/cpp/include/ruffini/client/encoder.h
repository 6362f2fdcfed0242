// What a host says to a sensor. Each call returns the bytes to write to the port.
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
  // `holder`: any number above 0 that no other host has, e.g. a random one. A sensor lets one host at a time change
  // something. The first bytes that you write should be those of hello(): they also end what a predecessor left half sent.
  explicit Encoder(uint32_t holder) : holder_(holder) {}

  Bytes hello();
  Bytes status();
  Bytes time(uint64_t token);
  // Each n-th message of each type, e.g. {{Type::kWrench, 1}, {Type::kField, 4}}; at most 16. Replaces what was asked before.
  Bytes subscribe(const std::vector<std::pair<Type, uint32_t>>& every);
  // Learn the untouched pad anew; n_frames 0: as many as the board says. REFUSED while something presses, unless meant.
  Bytes zero(uint32_t n_frames = 0, bool even_if_touched = false, uint8_t sensor = kDevice);

  // What subscribe and zero were sent under last; Reply has the same. Without a Reply within 0.5 s write the same bytes again.
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
