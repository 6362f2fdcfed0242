// What the board has beside camera, line and medium. Calls may wait for a bus: never in the frame thread, but for
// switch_reflex().
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace ruffini {

class BoardIo {
 public:
  BoardIo() = default;
  BoardIo(const BoardIo&) = delete;
  BoardIo& operator=(const BoardIo&) = delete;
  virtual ~BoardIo() = default;
  // Of the place that board.toml names; nothing where it is not measured.
  [[nodiscard]] virtual std::optional<int32_t> milli_celsius() const = 0;
  // What the computer says of its power and heat (hw/throttling.h); nothing where it does not.
  [[nodiscard]] virtual std::optional<uint32_t> throttled() const { return std::nullopt; }
  // The output line of [reflex]: whether there is one, and whether it could be switched. One system call.
  [[nodiscard]] virtual bool has_reflex() const { return false; }
  [[nodiscard]] virtual bool switch_reflex(bool /*is_on*/) { return false; }
  // The service manager: how often it wants to hear WATCHDOG=1 (0: never), and what it is told.
  [[nodiscard]] virtual uint64_t watchdog_us() const { return 0; }
  virtual void tell_manager(std::string_view /*what*/) {}
};

}  // namespace ruffini
