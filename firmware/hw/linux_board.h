// Peripherals of a board that runs Linux.
#pragma once

#include <memory>
#include <string>

#include "hw/board_io.h"
#include "hw/notify_socket.h"
#include "hw/output_line.h"
#include "hw/thermometer.h"
#include "hw/throttling.h"

namespace ruffini {

// Locations of the peripherals; empty: there is none.
struct LinuxPlaces {
  std::string thermometer;  // hw/thermometer.h
  std::string throttled;    // hw/throttling.h
  std::string reflex_chip;  // hw/output_line.h
  std::string reflex_line;
};

class LinuxBoard final : public BoardIo {
 public:
  // If the reflex line is unavailable, the sensor runs without it, and `problem` states why.
  LinuxBoard(const LinuxPlaces& places, NotifySocket manager, std::string& problem);

  [[nodiscard]] std::optional<int32_t> milli_celsius() const override { return thermometer_.milli_celsius(); }
  [[nodiscard]] std::optional<uint32_t> throttled() const override { return throttling_.bits(); }
  [[nodiscard]] bool has_reflex() const override { return reflex_ != nullptr; }
  [[nodiscard]] bool switch_reflex(bool is_on) override { return reflex_ != nullptr && reflex_->set(is_on); }
  [[nodiscard]] uint64_t watchdog_us() const override { return manager_.watchdog_us(); }
  void notify_manager(std::string_view what) override { manager_.send(what); }

 private:
  Thermometer thermometer_;
  Throttling throttling_;
  NotifySocket manager_;
  std::unique_ptr<OutputLine> reflex_;
};

}  // namespace ruffini
