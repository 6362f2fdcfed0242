// libFuzzer: any bytes from the line to the C++ consumer; or a payload of any type in a whole frame, so that a CRC that
// does not fit keeps nothing from the messages.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <variant>
#include <vector>

#include "link/frame_codec.h"
#include "ruffini/client.h"

namespace {

namespace client = ruffini::client;

void expect(bool holds) {
  if (!holds) std::abort();
}

void check(const client::Grid& grid, uint32_t n_components) {
  if (grid.values.empty()) return;
  expect(grid.values.size() <= 1U << 22 && grid.n_components == n_components);
  expect(grid.values.size() == grid.n_nodes() * n_components);
}

void check(const client::Measured& m) { expect(std::isnan(m.value) == (m.validity != client::Validity::kValid)); }

void check(const client::Packet& packet) {
  if (const auto* w = std::get_if<client::Wrench>(&packet.message)) {
    for (size_t i = 0; i < 3; ++i) {
      check(w->force_n[i]);
      check(w->torque_n_m[i]);
    }
  }
  if (const auto* d = std::get_if<client::Depth>(&packet.message)) check(d->depth_steps, 1);
  if (const auto* c = std::get_if<client::Contacts>(&packet.message)) expect(c->contacts.size() <= 64);
  if (const auto* f = std::get_if<client::Field>(&packet.message)) {
    for (const client::Grid* grid : {&f->force_steps, &f->displacement_steps, &f->sigma_steps}) check(*grid, 3);
    check(f->slip, 1);
    for (size_t node = 0; node < std::min<size_t>(f->force_steps.n_nodes(), 64); ++node) {
      expect(std::isnan(f->force_n_at(node)[0]) == (f->validity[0] != client::Validity::kValid));
      (void)f->displacement_m_at(node);
      (void)f->sigma_n_at(node);
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  client::Decoder decoder;
  const std::vector<uint8_t> rest(data + 1, data + size);
  if (data[0] == 0) {
    for (const auto& packet : decoder.feed(rest.data(), rest.size())) check(packet);
    return 0;
  }
  const uint8_t n_parts = static_cast<uint8_t>(
      std::max<size_t>((rest.size() + ruffini::kMaxPayloadBytes - 1) / ruffini::kMaxPayloadBytes, 1));
  size_t n_packets = 0;
  for (uint8_t i = 0; i < n_parts; ++i) {
    const size_t begin = i * ruffini::kMaxPayloadBytes;
    const size_t n = std::min(rest.size() - begin, ruffini::kMaxPayloadBytes);
    std::array<uint8_t, ruffini::kMaxFrameBytes> out;
    const size_t n_bytes = ruffini::encode_frame({0, data[0], 0, 0, i, n_parts}, {rest.data() + begin, n}, out);
    for (const auto& packet : decoder.feed(out.data(), n_bytes)) {
      check(packet);
      expect(packet.payload == rest);
      ++n_packets;
    }
  }
  expect(n_packets == 1);
  return 0;
}
