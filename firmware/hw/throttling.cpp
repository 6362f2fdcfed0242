#include "hw/throttling.h"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <charconv>

#include "base/unique_fd.h"

namespace ruffini {

std::optional<uint32_t> Throttling::bits() const {
  if (path_.empty()) return std::nullopt;
  const UniqueFd file(::open(path_.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  std::array<char, 32> text;
  const ssize_t n = ::read(file.get(), text.data(), text.size());
  if (n <= 0) return std::nullopt;
  const char* begin = text.data();
  const char* end = begin + n;
  if (n > 2 && begin[0] == '0' && begin[1] == 'x') begin += 2;
  uint32_t value = 0;
  const auto [rest, problem] = std::from_chars(begin, end, value, 16);
  if (problem != std::errc() || (rest != end && *rest != '\n')) return std::nullopt;
  return value;
}

}  // namespace ruffini
