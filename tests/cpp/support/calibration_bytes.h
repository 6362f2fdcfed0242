// Builds calibration files (proto/CALIBRATION.md) for tests; the signature is zeros.
#pragma once

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
    metadata_ += (metadata_.empty() ? "" : ",") + ("\"" + key + "\":\"" + value + "\"");
    return *this;
  }

  // Wider elements first, so that everything stays aligned.
  template <typename T>
  CalibrationBytes& tensor(const std::string& name, const std::string& dtype, const std::vector<int>& shape,
                           const std::vector<T>& values) {
    std::string sizes;
    for (const int n : shape) sizes += (sizes.empty() ? "" : ",") + std::to_string(n);
    const size_t begin = data_.size();
    data_.resize(begin + values.size() * sizeof(T));
    if (!values.empty()) std::memcpy(data_.data() + begin, values.data(), values.size() * sizeof(T));
    tensors_ += ",\"" + name + "\":{\"dtype\":\"" + dtype + "\",\"shape\":[" + sizes + "],\"data_offsets\":[" +
                std::to_string(begin) + "," + std::to_string(data_.size()) + "]}";
    return *this;
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
