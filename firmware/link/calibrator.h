// From uploaded bytes to a calibration in force: hash, layout, signature, target, bounds proof, then the
// medium, then the frame thread. Link thread only.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "board/settings.h"
#include "link/exchange.h"
#include "store/signature.h"
#include "store/slot_store.h"

namespace ruffini {

struct ActiveCalibration {
  bool is_present = false;
  std::string sha256;
  std::string created_utc;
  std::string kinds;
  Signer signer;
};

class Calibrator {
 public:
  static constexpr uint64_t kMaxUploadBytes = uint64_t{128} << 20;
  static constexpr size_t kMaxChunkBytes = 3'072;

  Calibrator(const BoardSettings& board, std::string serial, SlotStore store, Exchange& exchange);

  // The path for the calibration in force, where that is spoilt for the one before it, else without one; `problem` says
  // why a stored file was not used.
  [[nodiscard]] Result<std::unique_ptr<FramePath>> start(ClockFunction clock, std::string& problem);

  [[nodiscard]] Status begin(uint64_t size_bytes, const std::string& sha256);
  [[nodiscard]] Status chunk(uint64_t offset, std::span<const uint8_t> data);
  // On success the file is durable and handed to the frame thread.
  [[nodiscard]] Status commit();
  void abort();
  // Puts in force what was so before the last commit; once more takes that back.
  [[nodiscard]] Status undo();

  [[nodiscard]] uint64_t next_offset() const { return upload_.size(); }
  [[nodiscard]] bool is_receiving() const { return is_receiving_; }
  [[nodiscard]] bool is_complete() const { return is_receiving_ && upload_.size() == size_bytes_; }
  [[nodiscard]] const ActiveCalibration& active() const { return active_; }

 private:
  struct Prepared {
    std::unique_ptr<FramePath> path;
    ActiveCalibration calibration;
  };
  [[nodiscard]] Result<Prepared> prepare(std::span<const uint8_t> bytes) const;
  void put_in_force(Prepared prepared);

  BoardSettings board_;
  std::string serial_;
  SlotStore store_;
  Exchange& exchange_;
  ClockFunction clock_ = nullptr;
  ActiveCalibration active_;
  bool is_receiving_ = false;
  uint64_t size_bytes_ = 0;
  std::string expected_sha256_;
  std::vector<uint8_t> upload_;
};

}  // namespace ruffini
