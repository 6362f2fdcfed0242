#include "hw/linux_board.h"

#include <utility>

namespace ruffini {

LinuxBoard::LinuxBoard(const LinuxPlaces& places, NotifySocket manager, std::string& problem)
    : thermometer_(places.thermometer), throttling_(places.throttled), manager_(std::move(manager)) {
  if (places.reflex_line.empty()) return;
  auto line = open_output_line(places.reflex_chip, places.reflex_line);
  if (line) {
    reflex_ = std::move(line).value();
  } else {
    problem = "[reflex] " + line.error().message;
  }
}

}  // namespace ruffini
