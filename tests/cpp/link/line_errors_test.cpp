// What damage on the line the decoder sees: all of one and two flipped bits and every burst of up to 32 bits of the
// largest frame, all changes of one byte, every byte and every run of 512-byte pieces that is lost.
//
// The CRC is linear: what a set of flipped bits does to its residue is the XOR of what each does, its syndrome. So a
// set goes unseen only where the syndromes cancel, and all pairs are told by comparing single ones. That holds for bits
// that leave the COBS structure alone. The others (of a length byte, of a delimiter, or that make a byte zero) are
// flipped through the real decoder, each alone and each with every second bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cstdio>
#include <random>
#include <unordered_map>
#include <unordered_set>

#include "base/crc32c.h"
#include "link/frame_codec.h"

namespace ruffini {
namespace {

using Bytes = std::vector<uint8_t>;

constexpr size_t kCrcBytes = 4;
constexpr size_t kRawBytes = kHeaderBytes + kMaxPayloadBytes + kCrcBytes;  // the largest frame before COBS

void flip(Bytes& bytes, size_t bit) { bytes[bit / 8] ^= static_cast<uint8_t>(1U << bit % 8); }

// 0 where the CRC fits; reads `raw` as header, payload and CRC.
uint32_t residue(std::span<const uint8_t> raw) {
  uint32_t stored = 0;
  for (size_t i = 0; i < kCrcBytes; ++i) stored |= uint32_t{raw[raw.size() - kCrcBytes + i]} << (8 * i);
  return crc32c(raw.first(raw.size() - kCrcBytes)) ^ stored;
}

// One piece between two delimiters, `offset` bytes from the begin of the line.
struct Piece {
  bool is_cobs = true;
  Bytes raw;
  std::vector<size_t> from;   // where on the line each byte of `raw` stands; SIZE_MAX: nowhere, it is a zero
  std::vector<size_t> codes;  // where on the line the length bytes stand
};

// Cheshire and Baker, once more and on its own.
Piece unstuffed(std::span<const uint8_t> in, size_t offset) {
  Piece out;
  for (size_t at = 0; at < in.size();) {
    const size_t code = in[at];
    out.codes.push_back(offset + at);
    out.is_cobs = at + code <= in.size();
    if (!out.is_cobs) return out;
    for (size_t i = at + 1; i < at + code; ++i) {
      out.raw.push_back(in[i]);
      out.from.push_back(offset + i);
    }
    at += code;
    if (code == 0xFF || at == in.size()) continue;
    out.raw.push_back(0);
    out.from.push_back(SIZE_MAX);
  }
  return out;
}

// The syndrome of each bit of the largest frame; that of a shorter one is the same, counted from the end.
const std::vector<uint32_t>& syndromes() {
  static const std::vector<uint32_t> kSyndromes = [] {
    Bytes raw(kRawBytes, 0xA5);
    const uint32_t none = residue(raw);
    std::vector<uint32_t> out;
    for (size_t bit = 0; bit < 8 * raw.size(); ++bit) {
      flip(raw, bit);
      out.push_back(residue(raw) ^ none);
      flip(raw, bit);
    }
    return out;
  }();
  return kSyndromes;
}

TEST(LineErrors, TheSyndromeOfManyBitsIsTheirXor) {
  std::mt19937_64 random(1);
  for (int n = 0; n < 200; ++n) {
    Bytes raw(kRawBytes);
    for (uint8_t& byte : raw) byte = static_cast<uint8_t>(random());
    const uint32_t before = residue(raw);
    uint32_t all = 0;
    for (size_t k = random() % 40; k > 0; --k) {
      const size_t bit = random() % (8 * raw.size());
      flip(raw, bit);
      all ^= syndromes()[bit];
    }
    ASSERT_EQ(residue(raw) ^ before, all);
  }
}

TEST(LineErrors, EveryOneAndTwoFlippedBitsOfTheLargestFrameAreSeen) {
  const std::unordered_set<uint32_t> different(syndromes().begin(), syndromes().end());
  EXPECT_EQ(different.count(0), 0U) << "one bit goes unseen";
  EXPECT_EQ(different.size(), 8 * kRawBytes) << "two bits go unseen";
}

// 32 syndromes in a row are linearly independent wherever they begin: no set of them cancels, so no burst does.
TEST(LineErrors, EveryBurstOfUpTo32BitsOfTheLargestFrameIsSeen) {
  for (size_t first = 0; first + 32 <= syndromes().size(); ++first) {
    std::array<uint32_t, 32> basis{};  // by highest bit
    for (size_t i = 0; i < 32; ++i) {
      uint32_t v = syndromes()[first + i];
      while (v != 0) {
        uint32_t& b = basis[31 - static_cast<size_t>(std::countl_zero(v))];
        if (b == 0) {
          b = v;
          break;
        }
        v ^= b;
      }
      ASSERT_NE(v, 0U) << "a burst that begins at bit " << first;
    }
  }
}

// A frame as it travels, and one behind it; nothing else may be heard of them, whatever is done to the first.
class OnTheLine {
 public:
  explicit OnTheLine(const Bytes& payload) {
    append({.flags = kSimulated, .type = 5, .sequence = 0x01020304}, payload);
    n_first_ = wire_.size();
    append({.flags = kFromHost, .type = 1, .sensor = 255}, {});
  }

  [[nodiscard]] size_t n_bytes() const { return n_first_; }  // of the first frame, with its delimiter
  [[nodiscard]] const Bytes& wire() const { return wire_; }

  // What `wire` is cut into.
  [[nodiscard]] static std::vector<Piece> pieces(const Bytes& wire) {
    std::vector<Piece> out;
    for (size_t begin = 0; begin < wire.size();) {
      const auto from = wire.begin() + static_cast<ptrdiff_t>(begin);
      const auto n = static_cast<size_t>(std::find(from, wire.end(), 0) - from);
      out.push_back(unstuffed({wire.data() + begin, n}, begin));
      begin += n + 1;
    }
    return out;
  }

  // Bits of the first frame whose flip does not leave the COBS structure of `wire` alone.
  [[nodiscard]] std::vector<size_t> structural(const Bytes& wire) const {
    std::vector<bool> is_code(wire.size());
    for (const Piece& piece : pieces(wire)) {
      for (const size_t at : piece.codes) is_code[at] = true;
    }
    std::vector<size_t> out;
    for (size_t at = 0; at < n_first_; ++at) {
      for (size_t bit = 8 * at; bit < 8 * at + 8; ++bit) {
        if (wire[at] == 0 || is_code[at] || wire[at] == 1U << bit % 8) out.push_back(bit);
      }
    }
    return out;
  }

  // The bits that leave the structure of `wire` alone and with which the CRC of one of its pieces would fit.
  [[nodiscard]] static std::vector<size_t> bits_that_fit(const Bytes& wire) {
    static const std::unordered_map<uint32_t, size_t> kFromEnd = [] {
      std::unordered_map<uint32_t, size_t> out;
      for (size_t bit = 0; bit < syndromes().size(); ++bit) out[syndromes()[bit]] = syndromes().size() - bit;
      return out;
    }();
    std::vector<size_t> out;
    for (const Piece& piece : pieces(wire)) {
      if (!piece.is_cobs || piece.raw.size() < kHeaderBytes + kCrcBytes) continue;
      const auto found = kFromEnd.find(residue(piece.raw));
      if (found == kFromEnd.end() || found->second > 8 * piece.raw.size()) continue;
      const size_t bit = 8 * piece.raw.size() - found->second;
      if (piece.from[bit / 8] != SIZE_MAX) out.push_back(8 * piece.from[bit / 8] + bit % 8);
    }
    return out;
  }

  // The frames that are heard of `wire` and were never sent.
  [[nodiscard]] static int n_forged(const Bytes& wire, const Bytes& sent) {
    FrameDecoder decoder;
    int n = 0;
    for (const uint8_t byte : wire) {
      const auto frame = decoder.push(byte);
      if (!frame) continue;
      std::array<uint8_t, kMaxFrameBytes> again;
      const auto end = again.begin() + static_cast<ptrdiff_t>(encode_frame(frame->header, frame->payload, again));
      if (std::search(sent.begin(), sent.end(), again.begin(), end) == sent.end()) ++n;
    }
    return n;
  }
  [[nodiscard]] int n_forged(const Bytes& wire) const { return n_forged(wire, wire_); }

 private:
  void append(const FrameHeader& header, const Bytes& payload) {
    std::array<uint8_t, kMaxFrameBytes> frame;
    const size_t n = encode_frame(header, payload, frame);
    wire_.insert(wire_.end(), frame.begin(), frame.begin() + static_cast<ptrdiff_t>(n));
  }
  Bytes wire_;
  size_t n_first_ = 0;
};

Bytes noise(size_t n) {
  std::mt19937_64 random(7);
  Bytes out(n);
  for (uint8_t& byte : out) byte = static_cast<uint8_t>(random());
  return out;
}

// The largest frame, of noise and with few zeros, and smaller ones, into which the next frame could run.
std::vector<OnTheLine> frames() {
  Bytes rare(kMaxPayloadBytes, 0x5A);
  for (size_t i = 100; i < rare.size(); i += 401) rare[i] = 0;
  return {OnTheLine(noise(kMaxPayloadBytes)), OnTheLine(rare), OnTheLine(noise(600)), OnTheLine(Bytes(60))};
}

TEST(LineErrors, EveryFlippedBitOnTheLineIsSeen) {
  for (const OnTheLine& line : frames()) {
    Bytes wire = line.wire();
    for (size_t bit = 0; bit < 8 * line.n_bytes(); ++bit) {
      flip(wire, bit);
      ASSERT_EQ(line.n_forged(wire), 0) << "bit " << bit << " of " << line.n_bytes() << " bytes";
      flip(wire, bit);
    }
  }
}

// The pairs of bits of which one changes the structure; of the others EveryOneAndTwoFlippedBits... has told.
TEST(LineErrors, EveryTwoFlippedBitsOnTheLineAreSeen) {
  uint64_t n_pairs = 0;
  size_t n_structural = 0;
  size_t n_bits = 0;
  for (const OnTheLine& line : {OnTheLine(noise(kMaxPayloadBytes)), OnTheLine(noise(600))}) {
    Bytes wire = line.wire();
    const std::vector<size_t> first = line.structural(wire);
    const std::unordered_set<size_t> is_first(first.begin(), first.end());
    for (const size_t bit : first) {
      flip(wire, bit);
      std::vector<size_t> others = line.structural(wire);
      for (const size_t fitting : OnTheLine::bits_that_fit(wire)) others.push_back(fitting);
      for (const size_t second : others) {
        if (second == bit || (second < bit && is_first.count(second) != 0)) continue;  // that pair was seen to
        flip(wire, second);
        ASSERT_EQ(line.n_forged(wire), 0) << "bits " << bit << ", " << second;
        flip(wire, second);
      }
      flip(wire, bit);
    }
    const uint64_t n = 8 * line.n_bytes();
    n_pairs += n * (n - 1) / 2;
    if (n_bits == 0) {
      n_bits = n;
      n_structural = first.size();
    }
  }
  std::printf("%zu of %zu bits of the largest frame of noise change the structure; %llu pairs of bits, 0 unseen\n",
              n_structural, n_bits, static_cast<unsigned long long>(n_pairs));
}

// Any other value of one byte is a burst of 8 bits: where it leaves the structure alone the CRC sees it.
TEST(LineErrors, EveryOtherByteInThePlaceOfALengthIsSeen) {
  for (const OnTheLine& line : frames()) {
    Bytes wire = line.wire();
    std::vector<size_t> places = OnTheLine::pieces(wire).front().codes;
    places.push_back(line.n_bytes() - 1);  // the delimiter
    for (const size_t at : places) {
      const uint8_t was = wire[at];
      for (int value = 0; value < 256; ++value) {
        wire[at] = static_cast<uint8_t>(value);
        ASSERT_EQ(line.n_forged(wire), 0) << "byte " << at << " is " << value;
      }
      wire[at] = was;
    }
    for (size_t at = 0; at < line.n_bytes(); ++at) {
      const uint8_t was = wire[at];
      wire[at] = 0;
      ASSERT_EQ(line.n_forged(wire), 0) << "byte " << at << " is 0";
      wire[at] = was;
    }
  }
}

TEST(LineErrors, EveryByteThatIsLostOrComesTwiceIsSeen) {
  for (const OnTheLine& line : frames()) {
    for (size_t at = 0; at < line.n_bytes(); ++at) {
      const auto place = static_cast<ptrdiff_t>(at);
      Bytes wire = line.wire();
      wire.insert(wire.begin() + place, wire[at]);
      ASSERT_EQ(line.n_forged(wire), 0) << "byte " << at << " twice";
      wire.erase(wire.begin() + place, wire.begin() + place + 2);
      ASSERT_EQ(line.n_forged(wire), 0) << "byte " << at << " lost";
    }
  }
}

// A lagging host: whole pieces of 512 bytes are missing of a row of frames that are alike but for their numbers, so
// that the begin of one and the end of another are a frame of the right length.
TEST(LineErrors, EveryRunOfLostPiecesIsSeen) {
  Bytes sent;
  Bytes payload = noise(1'000);
  for (uint32_t i = 0; i < 12; ++i) {
    std::array<uint8_t, kMaxFrameBytes> frame;
    payload[400] = static_cast<uint8_t>(i);
    const size_t n = encode_frame({.type = 5, .sequence = 7'000 + i}, payload, frame);
    sent.insert(sent.end(), frame.begin(), frame.begin() + static_cast<ptrdiff_t>(n));
  }
  int n_runs = 0;
  for (size_t at = 0; at < 1'020; ++at) {
    for (size_t n = 512; n <= 4'096; n += 512) {
      Bytes wire = sent;
      const auto begin = wire.begin() + static_cast<ptrdiff_t>(at);
      wire.erase(begin, begin + static_cast<ptrdiff_t>(n));
      ASSERT_EQ(OnTheLine::n_forged(wire, sent), 0) << n << " bytes lost at " << at;
      ++n_runs;
    }
  }
  EXPECT_EQ(n_runs, 1'020 * 8);
}

}  // namespace
}  // namespace ruffini
