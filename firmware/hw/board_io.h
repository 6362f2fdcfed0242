// What the board has beside camera, line and medium. Calls may wait for a bus: never in the frame thread.
#pragma once

#include <cstdint>
#include <optional>

namespace ruffini {

class BoardIo {
 public:
  BoardIo() = default;
  BoardIo(const BoardIo&) = delete;
  BoardIo& operator=(const BoardIo&) = delete;
  virtual ~BoardIo() = default;
  // Of the place that board.toml names; nothing where it is not measured.
  [[nodiscard]] virtual std::optional<int32_t> milli_celsius() const = 0;
};

}  // namespace ruffini
