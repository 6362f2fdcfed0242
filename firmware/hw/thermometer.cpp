#include "hw/thermometer.h"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <charconv>

#include "base/unique_fd.h"

namespace ruffini {
namespace {

constexpr int32_t kColdest = -100'000;
constexpr int32_t kWarmest = 300'000;

}  // namespace

std::optional<int32_t> Thermometer::milli_celsius() const {
  if (path_.empty()) return std::nullopt;
  const UniqueFd file(::open(path_.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  std::array<char, 32> text;
  const ssize_t n = ::read(file.get(), text.data(), text.size());
  if (n <= 0) return std::nullopt;
  int32_t value = 0;
  const char* end = text.data() + n;
  const auto [rest, problem] = std::from_chars(text.data(), end, value);
  const bool is_whole = rest == end || *rest == '\n';
  if (problem != std::errc() || !is_whole || value < kColdest || value > kWarmest) return std::nullopt;
  return value;
}

}  // namespace ruffini
