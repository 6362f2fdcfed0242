#include "capture/paired_camera.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <string>

namespace ruffini {
namespace {

constexpr int kMaxAlone = 300;  // frames in a row without a partner

class PairedCamera final : public Camera {
 public:
  PairedCamera(std::unique_ptr<Camera> left, std::unique_ptr<Camera> right, int width_px, int height_px,
               uint64_t tolerance_us)
      : eyes_{Eye{std::move(left), {}}, Eye{std::move(right), {}}},
        row_bytes_(static_cast<size_t>(width_px / 2) * 3),
        n_rows_(static_cast<size_t>(height_px)),
        tolerance_us_(tolerance_us) {
    for (Eye& eye : eyes_) eye.frame.pixels.resize(row_bytes_ * n_rows_);
  }

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (!problem_.empty()) return CaptureStatus::kEnd;
    for (Eye& eye : eyes_) {
      if (eye.is_full) continue;
      const CaptureStatus status = eye.camera->capture(eye.frame);
      if (status == CaptureStatus::kEnd) problem_ = eye.camera->problem();
      if (status != CaptureStatus::kFrame) return status;
      eye.is_full = true;
    }
    Eye& left = eyes_[0];
    Eye& right = eyes_[1];
    const auto [early_us, late_us] = std::minmax(left.frame.capture_us, right.frame.capture_us);
    const uint64_t apart_us = late_us - early_us;
    // Recordings do not store capture times.
    const bool are_together = is_replay() ? left.frame.number == right.frame.number : apart_us <= tolerance_us_;
    if (!are_together) {
      const bool is_left_older =
          is_replay() ? left.frame.number < right.frame.number : left.frame.capture_us < right.frame.capture_us;
      (is_left_older ? left : right).is_full = false;
      return leave_alone(apart_us);
    }
    n_alone_ = 0;
    left.is_full = right.is_full = false;
    buffer.capture_us = early_us + apart_us / 2;
    buffer.number = left.frame.number;
    join(buffer.pixels.data());
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] std::string problem() const override { return problem_; }
  [[nodiscard]] bool is_simulated() const override {
    return eyes_[0].camera->is_simulated() || eyes_[1].camera->is_simulated();
  }
  [[nodiscard]] bool is_replay() const override { return eyes_[0].camera->is_replay(); }

 private:
  struct Eye {
    std::unique_ptr<Camera> camera;
    FramePool::Buffer frame;
    bool is_full = false;  // `frame` is waiting for its partner
  };

  CaptureStatus leave_alone(uint64_t apart_us) {
    if (++n_alone_ < kMaxAlone) return CaptureStatus::kInvalidFrame;
    problem_ = "the two cameras' frames are never together: the last two were " + std::to_string(apart_us) +
               " us apart, stereo.tolerance_us is " + std::to_string(tolerance_us_) +
               ": join the cameras' sync lines, or allow more";
    return CaptureStatus::kEnd;
  }

  void join(uint8_t* out) const {
    const uint8_t* left = eyes_[0].frame.pixels.data();
    const uint8_t* right = eyes_[1].frame.pixels.data();
    for (size_t row = 0; row < n_rows_; ++row) {
      out = std::copy_n(left + row * row_bytes_, row_bytes_, out);
      out = std::copy_n(right + row * row_bytes_, row_bytes_, out);
    }
  }

  std::array<Eye, 2> eyes_;
  size_t row_bytes_;
  size_t n_rows_;
  uint64_t tolerance_us_;
  int n_alone_ = 0;
  std::string problem_;
};

}  // namespace

Result<std::unique_ptr<Camera>> pair_cameras(std::unique_ptr<Camera> left, std::unique_ptr<Camera> right, int width_px,
                                             int height_px, uint64_t tolerance_us) {
  if (left->is_replay() != right->is_replay()) {
    return Error{ErrorKind::kBadInput, "--camera: one is a recording and one is live: give two of a kind"};
  }
  return std::unique_ptr<Camera>(
      std::make_unique<PairedCamera>(std::move(left), std::move(right), width_px, height_px, tolerance_us));
}

}  // namespace ruffini
