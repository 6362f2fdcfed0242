// Builds calibration files (proto/CALIBRATION.md) for tests; the signature is zeros.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace ruffini::test {

class CalibrationBytes {
 public:
  CalibrationBytes() {
    meta("format", "ruffini-calibration");
    meta("format_version", "1");
    meta("product", "ruffini");
  }

  CalibrationBytes& meta(const std::string& key, const std::string& value) {
    metadata_.append(metadata_.empty() ? "\"" : ",\"").append(key).append("\":\"").append(value).append("\"");
    return *this;
  }

  // Wider elements first, so that everything stays aligned.
  template <typename T>
  CalibrationBytes& tensor(const std::string& name, const std::string& dtype, const std::vector<int>& shape,
                           const std::vector<T>& values) {
    std::string sizes;
    for (const int n : shape) sizes.append(sizes.empty() ? "" : ",").append(std::to_string(n));
    const size_t begin = data_.size();
    data_.resize(begin + values.size() * sizeof(T));
    if (!values.empty()) std::memcpy(data_.data() + begin, values.data(), values.size() * sizeof(T));
    tensors_ += ",\"" + name + "\":{\"dtype\":\"" + dtype + "\",\"shape\":[" + sizes + "],\"data_offsets\":[" +
                std::to_string(begin) + "," + std::to_string(data_.size()) + "]}";
    return *this;
  }

  // A dense program (proto/CALIBRATION.md) of n_rows x n_cols entries, row by row, all with one shift.
  // Its tensors of 32 bits; the 16 and 8 bit ones follow with dense_entries, so that everything stays aligned.
  CalibrationBytes& dense_program(const std::string& name, int n_rows, int n_cols) {
    const auto identity = [](int n) {
      std::vector<int32_t> out(static_cast<size_t>(n));
      for (int i = 0; i < n; ++i) out[static_cast<size_t>(i)] = i + 1;
      return out;
    };
    return tensor(name + ".fold", "I32", {n_cols, 1}, identity(n_cols))
        .tensor(name + ".panel", "I32", {1, 6}, std::vector<int32_t>{0, 0, n_rows, 0, 0, 1})
        .tensor(name + ".segment", "I32", {1, 2}, std::vector<int32_t>{0, n_cols})
        .tensor(name + ".stage", "I32", {1, 2}, std::vector<int32_t>{n_rows, 0})
        .tensor(name + ".unfold", "I32", {n_rows, 1}, identity(n_rows));
  }
  CalibrationBytes& dense_entries(const std::string& name, int n_rows, int n_cols, const std::vector<int16_t>& rows) {
    const auto width = static_cast<size_t>(n_cols);
    const size_t n_blocks = (width + 31) / 32;
    std::vector<int16_t> out;
    for (size_t first = 0; first < static_cast<size_t>(n_rows); first += 8) {
      const size_t last = std::min(first + 8, static_cast<size_t>(n_rows));
      for (size_t b = 0; b < n_blocks; ++b) {
        for (size_t r = first; r < last; ++r) {
          for (size_t j = 32 * b; j < 32 * b + 32; ++j) out.push_back(j < width ? rows[r * width + j] : int16_t{0});
        }
      }
    }
    return tensor(name + ".entry", "I16", {static_cast<int>(out.size())}, out);
  }
  CalibrationBytes& dense_shifts(const std::string& name, int n_rows, int n_cols, uint8_t shift = 0) {
    const int n = n_rows * ((n_cols + 31) / 32);
    return tensor(name + ".shift", "U8", {n}, std::vector<uint8_t>(static_cast<size_t>(n), shift));
  }

  [[nodiscard]] std::vector<uint8_t> bytes() {
    tensor("zz_signature", "U8", {64}, std::vector<uint8_t>(64));
    std::string header = "{\"__metadata__\":{" + metadata_ + "}" + tensors_ + "}";
    header.resize((header.size() + 7) / 8 * 8, ' ');
    std::vector<uint8_t> out(8 + header.size());
    for (size_t i = 0; i < 8; ++i) out[i] = static_cast<uint8_t>(header.size() >> (8 * i));
    std::memcpy(out.data() + 8, header.data(), header.size());
    out.insert(out.end(), data_.begin(), data_.end());
    return out;
  }

 private:
  std::string metadata_;
  std::string tensors_;
  std::vector<uint8_t> data_;
};

}  // namespace ruffini::test
