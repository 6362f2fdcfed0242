// Board peripherals besides camera, line and medium. Calls may wait for a bus: do not use them in the frame thread,
// except switch_reflex().
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
  // Temperature of the sensor that board.toml names; no value if it is not measured.
  [[nodiscard]] virtual std::optional<int32_t> milli_celsius() const = 0;
  // Power and thermal state of the computer (hw/throttling.h); no value if it does not report any.
  [[nodiscard]] virtual std::optional<uint32_t> throttled() const { return std::nullopt; }
  // Output line of [reflex]: whether it exists, and whether it could be switched. One system call.
  [[nodiscard]] virtual bool has_reflex() const { return false; }
  [[nodiscard]] virtual bool switch_reflex(bool /*is_on*/) { return false; }
  // Service manager: interval at which it expects WATCHDOG=1 (0: never), and messages to it.
  [[nodiscard]] virtual uint64_t watchdog_us() const { return 0; }
  virtual void notify_manager(std::string_view /*what*/) {}
};

}  // namespace ruffini
