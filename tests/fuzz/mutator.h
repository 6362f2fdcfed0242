// Deterministic mutations of byte strings.
#pragma once

#include <cstdint>
#include <random>
#include <utility>
#include <vector>

namespace ruffini::fuzz {

using Bytes = std::vector<uint8_t>;

class Mutator {
 public:
  Mutator(std::vector<Bytes> seeds, uint64_t seed) : seeds_(std::move(seeds)), random_(seed) {}

  // One of the seeds with 1 to 4 mutations.
  Bytes next() {
    Bytes bytes = seeds_[below(seeds_.size())];
    for (size_t n = 1 + below(4); n > 0; --n) mutate(bytes);
    return bytes;
  }
  uint8_t byte() { return static_cast<uint8_t>(random_()); }
  size_t below(size_t n) { return static_cast<size_t>(random_() % n); }

 private:
  void mutate(Bytes& bytes) {
    if (bytes.empty()) {
      bytes.push_back(byte());
      return;
    }
    const size_t at = below(bytes.size());
    const auto place = bytes.begin() + static_cast<ptrdiff_t>(at);
    switch (below(7)) {
      case 0:
        bytes[at] ^= static_cast<uint8_t>(1U << below(8));
        break;
      case 1:
        bytes[at] = byte();
        break;
      case 2:
        bytes.insert(place, byte());
        break;
      case 3:
        bytes.erase(place);
        break;
      case 4:
        bytes.resize(at);
        break;
      case 5: {
        const Bytes& other = seeds_[below(seeds_.size())];
        bytes.resize(at);
        bytes.insert(bytes.end(), other.begin() + static_cast<ptrdiff_t>(below(other.size())), other.end());
        break;
      }
      default: {
        const Bytes copy = bytes;
        bytes.insert(bytes.end(), copy.begin(), copy.end());
      }
    }
  }

  std::vector<Bytes> seeds_;
  std::mt19937_64 random_;
};

}  // namespace ruffini::fuzz
