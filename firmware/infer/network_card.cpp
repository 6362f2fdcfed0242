#include <sodium.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>

#include "infer/learned_result.h"
#include "infer/network.h"

namespace ruffini {
namespace {

// Protocol Buffers: of ModelProto only metadata_props (field 14: key 1, value 2) is read; the weights are skipped.
constexpr uint64_t kMetadataProps = 14;
constexpr uint64_t kVarint = 0;
constexpr uint64_t kBytes = 2;
constexpr uint64_t kMaxEntryBytes = 4'096;
constexpr size_t kMaxEntries = 64;
constexpr uint64_t kMaxNetworkBytes = uint64_t{1} << 30;  // VGG16 as published has 0.54e9
constexpr size_t kMaxNameLength = 23;                     // Quantity.name in ruffini.options
constexpr const char* kPrefix = "ruffini.";

std::optional<uint64_t> read_varint(std::istream& in) {
  uint64_t value = 0;
  for (int shift = 0; shift < 64; shift += 7) {
    const int byte = in.get();
    if (byte == std::istream::traits_type::eof()) return std::nullopt;
    value |= static_cast<uint64_t>(byte & 0x7F) << shift;
    if (byte < 0x80) return value;
  }
  in.setstate(std::ios::failbit);
  return std::nullopt;
}

// Text of one field of `in`, which holds one metadata entry.
std::optional<std::string> read_text(std::istream& in, uint64_t field) {
  const auto tag = read_varint(in);
  const auto size = read_varint(in);
  if (tag != (field << 3 | kBytes) || !size || *size > kMaxEntryBytes) return std::nullopt;
  std::string text(*size, '\0');
  if (!in.read(text.data(), static_cast<std::streamsize>(*size))) return std::nullopt;
  return text;
}

// Returns false if the file is not a protobuf message, or has more metadata than any valid network.
bool read_metadata(std::istream& in, uint64_t n_bytes, std::map<std::string, std::string>& out) {
  while (const auto tag = read_varint(in)) {
    if ((*tag & 7) == kVarint) {
      if (!read_varint(in)) return false;
      continue;
    }
    const auto size = (*tag & 7) == kBytes ? read_varint(in) : std::nullopt;
    if (!size || *size > n_bytes - static_cast<uint64_t>(in.tellg())) return false;
    if (*tag >> 3 != kMetadataProps) {
      in.seekg(static_cast<std::streamoff>(*size), std::ios::cur);
      continue;
    }
    const std::streamoff end = in.tellg() + static_cast<std::streamoff>(*size);
    const auto key = read_text(in, 1);
    const auto value = read_text(in, 2);
    if (!key || !value || in.tellg() != end) return false;
    if (key->rfind(kPrefix, 0) == 0) out[key->substr(std::string(kPrefix).size())] = *value;
    if (out.size() > kMaxEntries) return false;
  }
  return in.eof();
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> parts;
  for (size_t begin = 0; begin <= text.size();) {
    const size_t end = std::min(text.find(',', begin), text.size());
    parts.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return parts;
}

// Sanitizes the file's text for a terminal and for messages, whose texts are UTF-8.
std::string plain(std::string text) {
  constexpr size_t kShown = 40;
  if (text.size() > kShown) text = text.substr(0, kShown) + "...";
  std::replace_if(text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return text;
}

bool is_name(const std::string& text) {
  return !text.empty() && text.size() <= kMaxNameLength && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
  });
}

bool to_numbers(const std::string& text, std::vector<int64_t>& out) {
  for (const std::string& part : split(text)) {
    int64_t value = 0;
    const auto [end, problem] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (problem != std::errc{} || end != part.data() + part.size()) return false;
    out.push_back(value);
  }
  return true;
}

std::string sha256_of(std::istream& in) {
  crypto_hash_sha256_state state;
  crypto_hash_sha256_init(&state);
  std::vector<char> bytes(size_t{1} << 16);
  while (in.read(bytes.data(), static_cast<std::streamsize>(bytes.size())) || in.gcount() > 0) {
    crypto_hash_sha256_update(&state, reinterpret_cast<const uint8_t*>(bytes.data()),
                              static_cast<unsigned long long>(in.gcount()));
  }
  std::array<uint8_t, crypto_hash_sha256_BYTES> hash{};
  crypto_hash_sha256_final(&state, hash.data());
  return {hash.begin(), hash.end()};
}

}  // namespace

Result<NetworkCard> read_network_card(const std::string& path, const BoardSettings& board) {
  std::error_code problem;  // opening a pipe would block forever
  const bool is_file = std::filesystem::is_regular_file(path, problem);
  std::ifstream in(is_file ? path : std::string(), std::ios::binary | std::ios::ate);
  if (!in) {
    return Error{ErrorKind::kUnavailable,
                 path + ": no such network: put it there, or leave [learned] out of board.toml"};
  }
  const auto n_bytes = static_cast<uint64_t>(std::max<std::streamoff>(in.tellg(), 0));
  if (n_bytes > kMaxNetworkBytes) {
    return Error{ErrorKind::kBadInput, path + ": is larger than 1 GiB: export a smaller network"};
  }
  in.seekg(0);
  std::map<std::string, std::string> said;
  NetworkCard card;
  if (!read_metadata(in, n_bytes, said) || said["format"] != "ruffini-network" || said["format_version"] != "1") {
    return Error{ErrorKind::kBadInput, path + ": no network of ruffini: make it with ruffini train"};
  }
  const std::string size = std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px);
  if (said["board"] != board.name || said["optics"] != board.camera.optics || said["resolution"] != size) {
    return Error{ErrorKind::kRefused, path + ": is for board " + plain(said["board"]) + ", optics " +
                                          plain(said["optics"]) + ", " + plain(said["resolution"]) + ", this is " +
                                          board.name + ", " + board.camera.optics + ", " + size + ": train its own"};
  }
  card.names = split(said["outputs"]);
  const bool has_ranges = to_numbers(said["low"], card.low) && to_numbers(said["high"], card.high);
  if (!has_ranges || card.names.size() > kMaxLearned || card.low.size() != card.names.size() ||
      card.high.size() != card.names.size() || !std::all_of(card.names.begin(), card.names.end(), is_name)) {
    return Error{ErrorKind::kBadInput, path + ": outputs, low and high of its metadata do not fit: export it again"};
  }
  in.clear();
  in.seekg(0);
  card.sha256 = sha256_of(in);
  return card;
}

}  // namespace ruffini
