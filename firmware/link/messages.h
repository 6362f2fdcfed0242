// Encodes FrameState as protobuf messages (nanopb) and these as frames, into preallocated memory.
//
// Frame thread. No allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "frame_path.h"
#include "infer/learned_result.h"
#include "link/dense_codec.h"
#include "link/frame_codec.h"
#include "ruffini.pb.h"

namespace ruffini {

struct FrameStamp {
  uint64_t capture_us = 0;  // mid-exposure, monotonic
  uint64_t frame = 0;
  uint32_t calibration_id = 0;
  uint8_t flags = 0;  // FrameFlag: simulated, replay
};

class MessageEncoder {
 public:
  // Receives all frames of one encoded message, back to back.
  using Sink = std::function<void(ruffini_MessageType, std::span<const uint8_t>)>;

  MessageEncoder(const FramePath& path, uint8_t sensor);

  // Encodes message `type` for the path's last frame and passes its frames to `sink`.
  void encode(ruffini_MessageType type, const FramePath& path, const FrameView& frame, const FrameStamp& stamp,
              const Sink& sink);
  // LEARNED: the result of the network with the names of its outputs. `flags`: of the frames (FrameFlag).
  void encode(const LearnedResult& result, std::span<const std::string> names, uint8_t flags, const Sink& sink);

 private:
  size_t wrench(const FramePath& path, const FrameStamp& stamp);
  size_t field(const FramePath& path, const FrameStamp& stamp);
  size_t residual(const FramePath& path, const FrameStamp& stamp);
  size_t depth(const FramePath& path, const FrameStamp& stamp);
  size_t contacts(const FramePath& path, const FrameStamp& stamp);
  size_t markers(const FramePath& path, const FrameStamp& stamp);
  size_t features(const FramePath& path, const FrameStamp& stamp);
  size_t targets(const FramePath& path, const FrameStamp& stamp);
  size_t image(const FrameView& frame, const FramePath& path, const FrameStamp& stamp);
  // Returns the bytes of the frames in frames_, 0 if the message cannot be sent.
  size_t serialise(const pb_msgdesc_t* fields, const void* message);
  void take(std::span<const uint8_t> bytes);
  void write_part();
  // `part`: index of the dense part within the message.
  void pack(ruffini_Dense& out, GridSize size, size_t n_components, size_t part);

  uint8_t sensor_;
  uint32_t sequence_ = 0;
  std::vector<int32_t> values_;
  static constexpr size_t kMaxParts = 4;                  // dense parts of one message
  std::array<std::vector<uint8_t>, kMaxParts> dense_;     // their packed bytes
  std::vector<uint8_t> row_;                              // of a picture of which only every n-th pixel is sent
  std::array<std::span<const uint8_t>, kMaxParts> span_;  // source of the nanopb callbacks
  FrameHeader header_;                                    // of the frame that is filled
  std::array<uint8_t, kMaxPayloadBytes> part_{};          // its part of the message
  size_t n_part_ = 0;
  std::vector<uint8_t> frames_;  // of the message
  size_t n_frames_ = 0;          // bytes of frames_ so far
};

// Splits a serialized message into frames. Returns the number of bytes written to `out` (frames_bound(message.size())),
// 0 if it needs more than kMaxFragments.
size_t write_frames(ruffini_MessageType type, uint8_t flags, uint8_t sensor, uint32_t sequence,
                    std::span<const uint8_t> message, std::vector<uint8_t>& out);

// Upper bound of the bytes that write_frames needs.
[[nodiscard]] constexpr size_t frames_bound(size_t n_message) {
  return (n_message / kMaxPayloadBytes + 1) * kMaxFrameBytes;
}

}  // namespace ruffini
