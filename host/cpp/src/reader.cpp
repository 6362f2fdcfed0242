#include "reader.h"

#include <algorithm>

#include "framing.h"

namespace ruffini::client {
namespace {

constexpr uint32_t kVarint = 0, kFixed64 = 1, kLength = 2, kFixed32 = 5;
constexpr size_t kBlock = 32;
constexpr uint64_t kMaxValues = 1U << 22;  // more than any sensor has: nothing from the wire allocates beyond it

// Bits of one block of 32 values, width bits each.
void unpack_block(const uint8_t* in, uint32_t width, int32_t* out) {
  const uint64_t mask = (uint64_t{1} << width) - 1;
  uint64_t bits = 0;
  uint32_t n_bits = 0;
  for (size_t i = 0; i < kBlock; ++i) {
    if (n_bits < width) {
      bits |= uint64_t{get_u32(in)} << n_bits;
      in += 4;
      n_bits += 32;
    }
    out[i] = static_cast<int32_t>(unzigzag(bits & mask));
    bits >>= width;
    n_bits -= width;
  }
}

// Whole blocks that hold n_values, which must be all of `in`; false otherwise.
bool unpack(const uint8_t* in, size_t n_bytes, size_t n_values, std::vector<int32_t>& out) {
  const size_t n_blocks = (n_values + kBlock - 1) / kBlock;
  if (n_bytes < n_blocks) return false;  // before anything is allocated
  out.assign(n_blocks * kBlock, 0);
  const uint8_t* end = in + n_bytes;
  for (size_t block = 0; block < n_blocks; ++block) {
    if (in == end) return false;
    const uint32_t width = *in++;
    if (width > 32 || static_cast<size_t>(end - in) < size_t{4} * width) return false;
    if (width > 0) unpack_block(in, width, &out[block * kBlock]);
    in += size_t{4} * width;
  }
  out.resize(n_values);
  return in == end;
}

bool unpack_sparse(const uint8_t* in, size_t n_bytes, Grid& grid) {
  const size_t n_nodes = grid.n_nodes();
  const size_t n_bitmap = (n_nodes + 7) / 8;
  if (n_bytes < n_bitmap) return false;
  const auto is_active = [&](size_t node) { return (in[node / 8] >> node % 8 & 1) != 0; };
  size_t n_active = 0;
  for (size_t node = 0; node < n_nodes; ++node) n_active += is_active(node) ? size_t{1} : size_t{0};
  for (size_t node = n_nodes; node < 8 * n_bitmap; ++node) {
    if (is_active(node)) return false;
  }
  std::vector<int32_t> packed;
  if (!unpack(in + n_bitmap, n_bytes - n_bitmap, n_active * grid.n_components, packed)) return false;
  grid.values.assign(n_nodes * grid.n_components, 0);
  const int32_t* from = packed.data();
  for (size_t node = 0; node < n_nodes; ++node) {
    if (!is_active(node)) continue;
    std::copy(from, from + grid.n_components, &grid.values[node * grid.n_components]);
    from += grid.n_components;
  }
  return true;
}

}  // namespace

uint64_t Reader::varint() {
  uint64_t value = 0;
  for (uint32_t shift = 0; shift < 64; shift += 7) {
    if (at_ == end_) break;
    const uint8_t byte = *at_++;
    value |= uint64_t{byte & 127U} << shift;
    if (byte < 128) return value;
  }
  is_ok_ = false;
  return 0;
}

bool Reader::next() {
  if (!is_ok_ || at_ == end_) return false;
  const uint64_t tag = varint();
  number_ = static_cast<uint32_t>(tag >> 3);
  wire_type_ = static_cast<uint32_t>(tag & 7);
  if (tag > UINT32_MAX || number_ == 0) is_ok_ = false;
  size_t n_skip = 0;
  if (wire_type_ == kVarint) {
    value_ = varint();
  } else if (wire_type_ == kLength) {
    const uint64_t n = varint();
    if (n > static_cast<uint64_t>(end_ - at_)) is_ok_ = false;
    bytes_ = at_;
    n_bytes_ = n_skip = static_cast<size_t>(n);
  } else if (wire_type_ == kFixed64 || wire_type_ == kFixed32) {
    n_skip = wire_type_ == kFixed64 ? 8 : 4;
  } else {
    is_ok_ = false;  // groups, which proto3 has no more
  }
  if (n_skip > static_cast<size_t>(end_ - at_)) is_ok_ = false;
  if (is_ok_) at_ += n_skip;
  return is_ok_;
}

uint64_t Reader::u64() {
  if (wire_type_ != kVarint) is_ok_ = false;
  return is_ok_ ? value_ : 0;
}

int64_t Reader::s64() { return unzigzag(u64()); }

int32_t Reader::s32() { return static_cast<int32_t>(unzigzag(u32())); }

Reader Reader::message() {
  if (wire_type_ != kLength) is_ok_ = false;
  return is_ok_ ? Reader(bytes_, n_bytes_) : Reader(bytes_, 0);
}

std::string Reader::text() {
  if (wire_type_ != kLength) is_ok_ = false;
  return is_ok_ ? std::string(bytes_, bytes_ + n_bytes_) : std::string();
}

void Reader::bytes(const uint8_t*& bytes, size_t& n) {
  if (wire_type_ != kLength) is_ok_ = false;
  bytes = bytes_;
  n = is_ok_ ? n_bytes_ : 0;
}

void Reader::repeated(std::vector<uint64_t>& out, size_t limit) {
  if (wire_type_ == kLength) {
    Reader packed(bytes_, n_bytes_);
    while (packed.at_ != packed.end_ && packed.is_ok_ && out.size() <= limit) out.push_back(packed.varint());
    is_ok_ = is_ok_ && packed.is_ok_;
  } else {
    out.push_back(u64());
  }
  if (out.size() > limit) is_ok_ = false;
}

bool read_grid(Reader r, Grid& out) {
  uint64_t codec = 0;
  uint64_t n_x = 0, n_y = 0, n_components = 0;
  const uint8_t* bytes = nullptr;
  size_t n_bytes = 0;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) codec = r.u64();
    if (n == 2) n_x = r.u32();
    if (n == 3) n_y = r.u32();
    if (n == 4) n_components = r.u32();
    if (n == 5) r.bytes(bytes, n_bytes);
  }
  if (!r.ok() || n_x == 0 || n_y == 0 || n_components == 0) return false;
  // Each is below 2^32, so the first product does not overflow, nor the second after the first is known to be small.
  if (n_x * n_y > kMaxValues || n_x * n_y * n_components > kMaxValues) return false;
  out.n_x = static_cast<uint32_t>(n_x);
  out.n_y = static_cast<uint32_t>(n_y);
  out.n_components = static_cast<uint32_t>(n_components);
  if (codec == 0) return unpack(bytes, n_bytes, out.n_nodes() * out.n_components, out.values);
  return codec == 1 && unpack_sparse(bytes, n_bytes, out);
}

}  // namespace ruffini::client
