// A camera whose driver and light have faults. It knows what each frame really showed.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "capture/camera.h"
#include "dice.h"
#include "event_log.h"
#include "faults.h"
#include "tiny_sensor.h"

namespace ruffini::sim {

class SimCamera final : public Camera {
 public:
  struct Shown {
    uint64_t number = 0;
    uint64_t taken_us = 0;    // truly
    uint64_t capture_us = 0;  // as its stamp says
    uint8_t picture = 0;
  };
  // Outlives the daemon's camera, as the real sensor does.
  struct Scene {
    uint8_t touch = 0;
    bool is_lifted = true;  // nothing may touch: rest is being learned
    uint64_t period_us = 16'667;
    uint64_t stalled_until_us = 0;
    uint64_t spoilt_until_us = 0;  // by `spoilt`: dark, glare or noise
    uint8_t spoilt = 0;
  };

  SimCamera(const TinySensor& sensor, const Scene& scene, Dice dice, Swarm& swarm, const uint64_t& now_us)
      : sensor_(sensor), scene_(scene), dice_(dice), swarm_(swarm), now_us_(now_us), due_us_(now_us + 100'000) {}

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (now_us_ < due_us_) return CaptureStatus::kNothing;
    due_us_ = now_us_ + scene_.period_us;
    if (now_us_ < scene_.stalled_until_us) return CaptureStatus::kNothing;
    ++number_;
    if (swarm_.strikes(Fault::kFrameLost, 20'000)) return CaptureStatus::kNothing;
    ++n_given_;
    if (swarm_.strikes(Fault::kFrameOfAnotherSize, 20'000)) return CaptureStatus::kInvalidFrame;
    Shown shown{number_, now_us_, now_us_ - 3'000, scene_.is_lifted ? uint8_t{0} : scene_.touch};
    if (now_us_ < scene_.spoilt_until_us && !scene_.is_lifted) shown.picture = scene_.spoilt;
    if (!scene_.is_lifted && !shown_.empty() && swarm_.strikes(Fault::kFrameTwice, 10'000))
      shown.picture = shown_.back().picture;
    if (swarm_.strikes(Fault::kTimeJumps, 2'000)) shown.capture_us = dice_.below(2 * now_us_);
    buffer.pixels = sensor_.pictures[shown.picture];
    // No two of 32 frames are alike where image/repeated_pictures looks.
    buffer.pixels[0] = static_cast<uint8_t>(buffer.pixels[0] ^ (number_ & 31));
    buffer.capture_us = shown.capture_us;
    buffer.number = shown.number;
    shown_.push_back(shown);
    if (shown_.size() > kKept) shown_.pop_front();
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

  [[nodiscard]] uint64_t due_us() const { return due_us_; }
  // Frames that the daemon was given, whole or not.
  [[nodiscard]] uint64_t n_given() const { return n_given_; }
  [[nodiscard]] std::optional<Shown> shown(uint64_t number) const {
    for (auto at = shown_.rbegin(); at != shown_.rend(); ++at) {
      if (at->number == number) return *at;
    }
    return std::nullopt;
  }

 private:
  static constexpr size_t kKept = 8'192;  // more than two minutes of a fast camera

  const TinySensor& sensor_;
  const Scene& scene_;
  Dice dice_;
  Swarm& swarm_;
  const uint64_t& now_us_;
  uint64_t due_us_;
  uint64_t number_ = 0;
  uint64_t n_given_ = 0;
  std::deque<Shown> shown_;
};

}  // namespace ruffini::sim
