#include "store/calibration.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace ruffini {
namespace {

constexpr size_t kMaxHeaderBytes = 65'536;
constexpr size_t kMaxTensors = 64;
constexpr size_t kMaxMetadata = 128;
constexpr size_t kMaxRank = 8;
constexpr std::string_view kSignatureName = "zz_signature";
constexpr size_t kSignatureBytes = 64;
constexpr std::array<std::string_view, 18> kKinds = {
    "camera",        "contact", "contact_depth", "contact_model", "dark",        "fingertip",
    "finite_strain", "gauge",   "marker_depth",  "operator",      "photometric", "relaxation",
    "rest",          "skin",    "softness",      "support",       "views",       "wrench"};

Error bad(const std::string& what) {
  return {ErrorKind::kBadInput, "calibration file: " + what + ": make or copy the file again"};
}

uint64_t read_u64(std::span<const uint8_t> bytes) {
  uint64_t value = 0;
  for (size_t i = 0; i < 8; ++i) value |= static_cast<uint64_t>(bytes[i]) << (8 * i);
  return value;
}

size_t item_bytes(Tensor::Type type) {
  switch (type) {
    case Tensor::Type::kU8:
      return 1;
    case Tensor::Type::kI16:
    case Tensor::Type::kU16:
      return 2;
    case Tensor::Type::kI32:
      return 4;
  }
  return 0;
}

}  // namespace

// The only JSON structure that is accepted as a safetensors header:
// {"__metadata__": {text: text...}, name: {"dtype": text, "shape": [n...], "data_offsets": [a, b]}...}
class HeaderParser {
 public:
  HeaderParser(std::span<const uint8_t> header, std::span<const uint8_t> data, Calibration& out)
      : text_(reinterpret_cast<const char*>(header.data()), header.size()), data_(data), out_(out) {}

  // Returns "" on success, otherwise the problem.
  std::string run() {
    if (std::any_of(text_.begin(), text_.end(), [](char c) { return static_cast<uint8_t>(c) >= 0x80; })) {
      return "header is not plain ASCII";  // HELLO repeats parts of it and must be UTF-8
    }
    if (!take('{')) return "header does not start with {";
    size_t next_offset = 0;
    do {
      std::string_view name;
      if (!take_name(name) || !take(':')) return "header key is not a plain string";
      std::string problem = name == "__metadata__" ? metadata() : tensor(name, next_offset);
      if (!problem.empty()) return problem;
    } while (take(','));
    if (!take('}')) return "header is not closed";
    skip_spaces();
    if (at_ != text_.size()) return "bytes after the header's end";
    if (next_offset != data_.size()) return "bytes after the last tensor, or a truncated file";
    return signature();
  }

 private:
  void skip_spaces() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\n')) ++at_;
  }
  bool take(char c) {
    skip_spaces();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }
  // Parses a string without escapes: names and keys.
  bool take_name(std::string_view& out) {
    if (!take('"')) return false;
    const size_t begin = at_;
    while (at_ < text_.size() && text_[at_] != '"') {
      if (text_[at_] == '\\' || static_cast<unsigned char>(text_[at_]) < 0x20) return false;
      ++at_;
    }
    if (at_ >= text_.size()) return false;
    out = text_.substr(begin, at_ - begin);
    ++at_;
    return !out.empty();
  }
  // Parses a string value; escapes \" \\ \/ \n \t.
  bool take_value(std::string& out) {
    if (!take('"')) return false;
    while (at_ < text_.size() && text_[at_] != '"') {
      char c = text_[at_++];
      if (static_cast<unsigned char>(c) < 0x20) return false;
      if (c == '\\') {
        if (at_ >= text_.size()) return false;
        const char kind = text_[at_++];
        if (kind == 'n')
          c = '\n';
        else if (kind == 't')
          c = '\t';
        else if (kind == '"' || kind == '\\' || kind == '/')
          c = kind;
        else
          return false;
      }
      out.push_back(c);
    }
    return take('"');
  }
  bool take_number(uint64_t& out) {
    skip_spaces();
    const size_t begin = at_;
    out = 0;
    while (at_ < text_.size() && text_[at_] >= '0' && text_[at_] <= '9') {
      if (at_ - begin >= 15) return false;  // below 2^53, so no overflow anywhere
      out = out * 10 + static_cast<uint64_t>(text_[at_++] - '0');
    }
    return at_ > begin;
  }

  std::string metadata() {
    if (!out_.metadata_.empty() || !take('{')) return "__metadata__ is repeated or not an object";
    do {
      std::string_view key;
      std::string value;
      if (!take_name(key) || !take(':') || !take_value(value)) return "__metadata__ is not text to text";
      for (const auto& entry : out_.metadata_) {
        if (entry.key == key) return "duplicate metadata key " + std::string(key);
      }
      if (out_.metadata_.size() >= kMaxMetadata) return "too many metadata keys";
      out_.metadata_.push_back({std::string(key), std::move(value)});
    } while (take(','));
    return take('}') ? "" : "__metadata__ is not closed";
  }

  std::string tensor(std::string_view name, size_t& next_offset) {
    const std::string what = "tensor " + std::string(name);
    if (out_.tensors_.size() >= kMaxTensors) return "too many tensors";
    if (out_.tensor(name) != nullptr) return "duplicate " + what;
    Tensor tensor;
    tensor.name = name;
    uint64_t begin = 0;
    uint64_t end = 0;
    std::string_view key;
    std::string_view type;
    if (!take('{') || !take_name(key) || key != "dtype" || !take(':') || !take_name(type) || !take(',')) {
      return what + " has no dtype";
    }
    if (type == "U8")
      tensor.type = Tensor::Type::kU8;
    else if (type == "I16")
      tensor.type = Tensor::Type::kI16;
    else if (type == "U16")
      tensor.type = Tensor::Type::kU16;
    else if (type == "I32")
      tensor.type = Tensor::Type::kI32;
    else
      return what + " has unknown dtype " + std::string(type);
    if (!take_name(key) || key != "shape" || !take(':') || !take_shape(tensor.shape) || !take(',')) {
      return what + " has no shape";
    }
    if (!take_name(key) || key != "data_offsets" || !take(':') || !take('[') || !take_number(begin) || !take(',') ||
        !take_number(end) || !take(']') || !take('}')) {
      return what + " has no data_offsets";
    }
    uint64_t size = item_bytes(tensor.type);
    for (const int64_t n : tensor.shape) {
      size *= static_cast<uint64_t>(n);
      if (size > data_.size()) return what + " is larger than the file";
    }
    if (begin != next_offset || end - begin != size || end > data_.size() || end < begin) {
      return what + " does not lie where the one before it ends";
    }
    tensor.bytes = data_.subspan(begin, size);
    if (reinterpret_cast<uintptr_t>(tensor.bytes.data()) % item_bytes(tensor.type) != 0) {
      return what + " is not aligned";
    }
    next_offset = end;
    out_.tensors_.push_back(std::move(tensor));
    return "";
  }

  bool take_shape(std::vector<int64_t>& shape) {
    if (!take('[')) return false;
    if (take(']')) return true;
    do {
      uint64_t n = 0;
      if (!take_number(n) || n == 0 || shape.size() >= kMaxRank) return false;
      shape.push_back(static_cast<int64_t>(n));
    } while (take(','));
    return take(']');
  }

  std::string signature() {
    if (out_.tensors_.empty()) return "no tensors";
    const Tensor& last = out_.tensors_.back();
    if (last.name != kSignatureName || last.bytes.size() != kSignatureBytes) {
      return "the last tensor is not a 64 byte zz_signature";
    }
    out_.signature_ = last.bytes;
    return "";
  }

  std::string_view text_;
  std::span<const uint8_t> data_;
  Calibration& out_;
  size_t at_ = 0;
};

Result<Calibration> Calibration::parse(std::span<const uint8_t> file) {
  if (file.size() < 8 + kSignatureBytes) return bad("is too short");
  const uint64_t header_bytes = read_u64(file);
  if (header_bytes > kMaxHeaderBytes || header_bytes > file.size() - 8 || header_bytes % 8 != 0) {
    return bad("header length " + std::to_string(header_bytes) + " makes no sense");
  }
  Calibration out;
  HeaderParser parser(file.subspan(8, header_bytes), file.subspan(8 + header_bytes), out);
  const std::string problem = parser.run();
  if (!problem.empty()) return bad(problem);
  out.signed_bytes_ = file.first(file.size() - kSignatureBytes);
  if (out.text("format") != "ruffini-calibration" || out.text("format_version") != "1") {
    return bad("is not a ruffini calibration of format version 1");
  }
  const Status known = out.check_kinds();
  if (!known) return known.error();
  return out;
}

// A kind that this firmware does not know could change the meaning of the others, so the file is refused.
Status Calibration::check_kinds() const {
  for (std::string_view rest = text("kinds"); !rest.empty();) {
    const size_t comma = std::min(rest.find(','), rest.size());
    const std::string_view kind = rest.substr(0, comma);
    if (std::find(kKinds.begin(), kKinds.end(), kind) == kKinds.end()) {
      return bad("kind \"" + std::string(kind) + "\" is unknown");
    }
    rest.remove_prefix(std::min(comma + 1, rest.size()));
  }
  for (const Tensor& tensor : tensors_) {
    if (tensor.name != kSignatureName && !has_kind(tensor.name.substr(0, tensor.name.find('.')))) {
      return bad("tensor " + std::string(tensor.name) + " belongs to no kind that the file names");
    }
  }
  return Unit{};
}

std::string_view Calibration::text(std::string_view key) const {
  for (const Entry& entry : metadata_) {
    if (entry.key == key) return entry.value;
  }
  return {};
}

Result<int64_t> Calibration::integer(std::string_view key, int64_t low, int64_t high) const {
  const std::string_view digits = text(key);
  int64_t value = 0;
  bool valid = !digits.empty() && digits.size() <= 15;
  for (const char c : digits) {
    valid = valid && c >= '0' && c <= '9';
    value = value * 10 + (c - '0');
    if (!valid) break;
  }
  if (!valid || value < low || value > high) {
    return bad(std::string(key) + " = \"" + std::string(digits) + "\" is not an integer from " + std::to_string(low) +
               " to " + std::to_string(high));
  }
  return value;
}

const Tensor* Calibration::tensor(std::string_view name) const {
  for (const Tensor& tensor : tensors_) {
    if (tensor.name == name) return &tensor;
  }
  return nullptr;
}

Result<const Tensor*> Calibration::tensor(std::string_view name, Tensor::Type type,
                                          const std::vector<int64_t>& shape) const {
  const Tensor* found = tensor(name);
  if (found == nullptr) return bad("tensor " + std::string(name) + " is missing");
  if (found->type != type || found->shape != shape) {
    return bad("tensor " + std::string(name) + " has another type or shape than this board needs");
  }
  return found;
}

bool Calibration::has_kind(std::string_view kind) const {
  std::string_view rest = text("kinds");
  while (!rest.empty()) {
    const size_t comma = std::min(rest.find(','), rest.size());
    if (rest.substr(0, comma) == kind) return true;
    rest.remove_prefix(std::min(comma + 1, rest.size()));
  }
  return false;
}

Status Calibration::check_target(const BoardSettings& board, std::string_view sensor_serial) const {
  const std::string resolution = std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px);
  const auto refuse = [](std::string_view what, std::string_view theirs, std::string_view ours) -> Error {
    return {ErrorKind::kRefused, "calibration is for " + std::string(what) + " \"" + std::string(theirs) +
                                     "\", this is \"" + std::string(ours) + "\": use the right file"};
  };
  if (text("product") != "ruffini") return refuse("product", text("product"), "ruffini");
  if (text("board") != board.name) return refuse("board", text("board"), board.name);
  if (text("resolution") != resolution) return refuse("resolution", text("resolution"), resolution);
  const std::string_view serial = text("sensor_serial");
  if (serial != "*" && serial != sensor_serial) return refuse("sensor", serial, sensor_serial);
  return Unit{};
}

}  // namespace ruffini
