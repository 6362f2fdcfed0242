// Frames by proto/README.md, written a second time: what the device says and hears is judged by this, not by its own codec.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace ruffini::sim {

struct ReferenceFrame {
  uint8_t flags = 0;
  uint8_t type = 0;
  uint8_t sensor = 0;
  uint32_t sequence = 0;
  uint8_t fragment = 0;
  uint8_t n_fragments = 1;
  std::vector<uint8_t> payload;
  uint64_t begun_us = 0;  // when its first byte came
};

// One frame of a host, about the device itself.
[[nodiscard]] std::vector<uint8_t> reference_frame(uint8_t type, std::span<const uint8_t> payload, uint32_t sequence);

class ReferenceDecoder {
 public:
  std::optional<ReferenceFrame> push(uint8_t byte, uint64_t now_us);
  // Frames that were thrown away.
  [[nodiscard]] uint64_t n_damaged() const { return n_damaged_; }

 private:
  std::vector<uint8_t> encoded_;
  bool is_oversize_ = false;
  uint64_t begun_us_ = 0;
  uint64_t n_damaged_ = 0;
};

}  // namespace ruffini::sim
