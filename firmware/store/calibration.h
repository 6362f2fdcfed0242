// Parser for the calibration file (proto/CALIBRATION.md). It never copies the file.
//
// Every length and offset in the file is checked before use. The results are views, valid as long as the bytes are. No
// floating point, no system call, no allocation whose size the file determines.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

struct Tensor {
  enum class Type { kU8, kI16, kU16, kI32 };
  std::string_view name;
  Type type = Type::kU8;
  std::vector<int64_t> shape;
  std::span<const uint8_t> bytes;

  template <typename T>
  [[nodiscard]] std::span<const T> as() const {
    return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
  }
};

class Calibration {
 public:
  // Views into `file`, which must be 8-byte aligned and outlive the result. Errors: kBadInput.
  [[nodiscard]] static Result<Calibration> parse(std::span<const uint8_t> file);

  // Returns "" if the key is absent.
  [[nodiscard]] std::string_view text(std::string_view key) const;
  // Returns kBadInput if the key is absent, not a decimal integer, or outside [low, high].
  [[nodiscard]] Result<int64_t> integer(std::string_view key, int64_t low, int64_t high) const;
  [[nodiscard]] const Tensor* tensor(std::string_view name) const;
  // Returns kBadInput if the tensor is absent or has another type or shape.
  [[nodiscard]] Result<const Tensor*> tensor(std::string_view name, Tensor::Type type,
                                             const std::vector<int64_t>& shape) const;
  [[nodiscard]] bool has_kind(std::string_view kind) const;

  // Bytes covered by the signature, and the signature (64 bytes).
  [[nodiscard]] std::span<const uint8_t> signed_bytes() const { return signed_bytes_; }
  [[nodiscard]] std::span<const uint8_t> signature() const { return signature_; }

  // Refuses (kRefused) a file for another product, board, resolution or sensor.
  [[nodiscard]] Status check_target(const BoardSettings& board, std::string_view sensor_serial) const;

 private:
  struct Entry {
    std::string key;
    std::string value;
  };
  [[nodiscard]] Status check_kinds() const;

  std::vector<Entry> metadata_;
  std::vector<Tensor> tensors_;
  std::span<const uint8_t> signed_bytes_;
  std::span<const uint8_t> signature_;
  friend class HeaderParser;
};

}  // namespace ruffini
