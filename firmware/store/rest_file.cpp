#include "store/rest_file.h"

#include <algorithm>
#include <array>
#include <string>

#include "base/crc32c.h"

namespace ruffini {
namespace {

constexpr char kName[] = "rest";
constexpr char kNewName[] = "rest.new";
constexpr std::array<uint8_t, 8> kMagic = {'R', 'R', 'E', 'S', 'T', '1', 0, 0};
constexpr size_t kHeadBytes = kMagic.size() + 2 * sizeof(uint32_t);

void put(std::vector<uint8_t>& bytes, uint32_t value, size_t n) {
  for (size_t i = 0; i < n; ++i) bytes.push_back(static_cast<uint8_t>(value >> (8 * i)));
}

std::vector<uint8_t> head_of(int width_px, int height_px) {
  std::vector<uint8_t> bytes(kMagic.begin(), kMagic.end());
  put(bytes, static_cast<uint32_t>(width_px), sizeof(uint32_t));
  put(bytes, static_cast<uint32_t>(height_px), sizeof(uint32_t));
  return bytes;
}

Status write_new(Storage& medium, std::span<const uint8_t> bytes) {
  const auto names = medium.list();
  if (!names) return names.error();
  if (std::find(names.value().begin(), names.value().end(), kNewName) != names.value().end()) {
    if (Status removed = medium.remove(kNewName); !removed) return removed;
  }
  auto file = medium.create(kNewName, bytes.size());
  if (!file) return file.error();
  if (Status written = file.value()->write(bytes); !written) return written;
  return file.value()->sync();
}

}  // namespace

std::vector<uint16_t> load_rest(const Storage& medium, int width_px, int height_px) {
  const auto file = medium.read(kName, ReadFrom::kAnywhere);
  if (!file) return {};
  const std::span<const uint8_t> bytes = file.value();
  const size_t n_values = size_t{3} * static_cast<size_t>(width_px) * static_cast<size_t>(height_px);
  const size_t crc_at = kHeadBytes + 2 * n_values;
  if (bytes.size() != crc_at + sizeof(uint32_t)) return {};
  const std::vector<uint8_t> head = head_of(width_px, height_px);
  std::vector<uint8_t> crc;
  put(crc, crc32c(bytes.first(crc_at)), sizeof(uint32_t));
  if (!std::equal(head.begin(), head.end(), bytes.begin()) ||
      !std::equal(crc.begin(), crc.end(), bytes.begin() + static_cast<ptrdiff_t>(crc_at))) {
    return {};
  }
  std::vector<uint16_t> rest(n_values);
  for (size_t i = 0; i < n_values; ++i) {
    rest[i] = static_cast<uint16_t>(bytes[kHeadBytes + 2 * i] | bytes[kHeadBytes + 2 * i + 1] << 8);
  }
  return rest;
}

Status save_rest(Storage& medium, std::span<const uint16_t> rest, int width_px, int height_px) {
  std::vector<uint8_t> bytes = head_of(width_px, height_px);
  bytes.reserve(kHeadBytes + 2 * rest.size() + sizeof(uint32_t));
  for (const uint16_t value : rest) put(bytes, value, sizeof(uint16_t));
  put(bytes, crc32c(bytes), sizeof(uint32_t));
  if (Status written = write_new(medium, bytes); !written) return written;
  if (Status named = medium.rename(kNewName, kName); !named) return named;
  return medium.sync_folder();
}

}  // namespace ruffini
