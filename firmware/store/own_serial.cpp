#include "store/own_serial.h"

#include <algorithm>
#include <array>
#include <cctype>

#include "store/folder_storage.h"

namespace ruffini {
namespace {

constexpr char kName[] = "serial";
constexpr char kTemporary[] = "serial.tmp";
constexpr size_t kDigits = 8;

std::string drawn(Random& random) {
  std::array<uint8_t, kDigits> bytes{};
  random.fill(bytes);
  std::string serial;
  for (const uint8_t byte : bytes) serial += "0123456789abcdef"[byte % 16];
  return serial;
}

std::string kept(const Storage& medium) {
  const auto bytes = medium.read(kName, ReadFrom::kAnywhere);
  if (!bytes) return "";
  const std::string serial(bytes.value().begin(), bytes.value().end());
  const bool is_whole = serial.size() == kDigits && std::all_of(serial.begin(), serial.end(),
                                                                [](unsigned char c) { return std::isxdigit(c) != 0; });
  return is_whole ? serial : "";
}

Status keep(Storage& medium, const std::string& serial) {
  (void)medium.remove(kTemporary);  // left by a start that was interrupted
  {
    auto file = medium.create(kTemporary, serial.size());
    if (!file) return file.error();
    Status done = file.value()->write({reinterpret_cast<const uint8_t*>(serial.data()), serial.size()});
    if (done) done = file.value()->sync();
    if (!done) return done;
  }
  const Status done = medium.rename(kTemporary, kName);
  return done ? medium.sync_folder() : done;
}

}  // namespace

std::string own_serial(const std::string& folder, Random& random) {
  const auto medium = FolderStorage::open(folder);
  if (!medium) return "0000";
  if (const std::string serial = kept(*medium.value()); !serial.empty()) return serial;
  const std::string serial = drawn(random);
  return keep(*medium.value(), serial) ? serial : "0000";
}

}  // namespace ruffini
