// What happened, line by line. The hash is always there; the text costs time and is kept where it is asked for.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>

namespace ruffini::sim {

class EventLog {
 public:
  explicit EventLog(bool keeps_text) : keeps_text_(keeps_text) {}

  void say(uint64_t now_us, std::string_view what, std::initializer_list<uint64_t> numbers = {}) {
    mix(now_us);
    for (const char c : what) mix_byte(static_cast<uint8_t>(c));
    for (const uint64_t n : numbers) mix(n);
    if (!keeps_text_) return;
    text_ += std::to_string(now_us);
    text_ += ' ';
    text_ += what;
    for (const uint64_t n : numbers) text_ += ' ' + std::to_string(n);
    text_ += '\n';
  }
  // FNV-1a over all lines.
  [[nodiscard]] uint64_t hash() const { return hash_; }
  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  void mix_byte(uint8_t byte) { hash_ = (hash_ ^ byte) * 0x0000'0100'0000'01B3; }
  void mix(uint64_t n) {
    for (int i = 0; i < 64; i += 8) mix_byte(static_cast<uint8_t>(n >> i));
  }

  bool keeps_text_;
  uint64_t hash_ = 0xCBF2'9CE4'8422'2325;
  std::string text_;
};

}  // namespace ruffini::sim
