#include "capture/alternating_camera.h"

#include <string>
#include <utility>
#include <vector>

#include "base/ambient.h"

namespace ruffini {
namespace {

constexpr int kMaxWithoutPair = 600;  // frames in a row

class AlternatingCamera final : public Camera {
 public:
  AlternatingCamera(std::unique_ptr<Camera> camera, LampsDuring lamps, size_t n_bytes)
      : camera_(std::move(camera)), lamps_(std::move(lamps)), dark_(n_bytes) {}

  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (!problem_.empty()) return CaptureStatus::kEnd;
    const CaptureStatus status = camera_->capture(buffer);
    if (status == CaptureStatus::kEnd) problem_ = camera_->problem();
    if (status != CaptureStatus::kFrame) return status;
    const Lamps lamps = lamps_(buffer);
    const bool is_pair = lamps == Lamps::kLit && has_dark_ && buffer.number == dark_number_ + 1;
    const bool lost_one = has_dark_ && !is_pair;  // a dark frame whose lit frame did not arrive
    has_dark_ = lamps == Lamps::kDark;
    if (is_pair) {
      n_alone_ = 0;
      take_ambient_away(buffer.pixels, dark_);
      buffer.number /= 2;
      return CaptureStatus::kFrame;
    }
    if (++n_alone_ >= kMaxWithoutPair) {
      problem_ =
          "light.alternation: no lit frame follows a dark one: is [light] the line of the lamps, and do exposure "
          "and read-out leave a gap between two frames?";
      return CaptureStatus::kEnd;
    }
    if (!has_dark_) return CaptureStatus::kInvalidFrame;
    dark_number_ = buffer.number;
    std::swap(dark_, buffer.pixels);  // same size, so nothing is copied
    return lost_one ? CaptureStatus::kInvalidFrame : CaptureStatus::kNothing;
  }
  [[nodiscard]] std::string problem() const override { return problem_; }
  [[nodiscard]] bool is_simulated() const override { return camera_->is_simulated(); }
  [[nodiscard]] bool is_replay() const override { return camera_->is_replay(); }

 private:
  std::unique_ptr<Camera> camera_;
  LampsDuring lamps_;
  std::vector<uint8_t> dark_;
  uint64_t dark_number_ = 0;
  bool has_dark_ = false;
  int n_alone_ = 0;
  std::string problem_;
};

}  // namespace

Lamps lamps_by_number(const FramePool::Buffer& frame) { return frame.number % 2 == 1 ? Lamps::kLit : Lamps::kDark; }

std::unique_ptr<Camera> alternate(std::unique_ptr<Camera> camera, LampsDuring lamps, size_t n_bytes) {
  return std::make_unique<AlternatingCamera>(std::move(camera), std::move(lamps), n_bytes);
}

}  // namespace ruffini
