// A fuzzer's bytes as a list of decisions; zeros where they end.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace ruffini::fuzz {

using Bytes = std::vector<uint8_t>;

class Input {
 public:
  Input(const uint8_t* data, size_t size) : left_(data, size) {}

  [[nodiscard]] bool is_empty() const { return left_.empty(); }
  uint8_t u8() {
    if (left_.empty()) return 0;
    const uint8_t byte = left_.front();
    left_ = left_.subspan(1);
    return byte;
  }
  uint16_t u16() {
    const uint8_t low = u8();
    return static_cast<uint16_t>(low | u8() << 8);
  }
  // At most n bytes.
  Bytes bytes(size_t n) {
    n = std::min(n, left_.size());
    Bytes out(left_.begin(), left_.begin() + static_cast<ptrdiff_t>(n));
    left_ = left_.subspan(n);
    return out;
  }
  // `bytes` with up to three places changed: as a file that was damaged or made by somebody.
  Bytes spoilt(Bytes bytes) {
    for (int n = u8() % 4; n > 0 && !bytes.empty(); --n) {
      const size_t at = (size_t{u16()} << 8 | u8()) % bytes.size();
      const uint8_t how = u8();
      if (how == 255) {
        bytes.resize(at);
      } else {
        bytes[at] = static_cast<uint8_t>(bytes[at] ^ how);
      }
    }
    return bytes;
  }

 private:
  std::span<const uint8_t> left_;
};

}  // namespace ruffini::fuzz
