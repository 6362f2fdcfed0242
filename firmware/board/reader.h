// Typed, checked reading of one board.toml.
#pragma once

#include <algorithm>
#include <set>
#include <string>
#include <vector>

#include "board/plain_toml.h"
#include "board/settings.h"

namespace ruffini {

// Reads the keys of one file; stores the first error and which keys were requested.
class BoardReader {
 public:
  BoardReader(toml::table root, std::string where) : root_(std::move(root)), where_(std::move(where)) {}

  // The file, including the defaults added by set_default().
  [[nodiscard]] const toml::table& root() const { return root_; }

  [[nodiscard]] bool has_section(const char* name) const { return root_.contains(name); }

  void section(const char* name) {
    section_ = name;
    asked_sections_.insert(name);
    table_ = root_.get_as<toml::table>(name);
    if (!has_section(name)) return fail("section [" + section_ + "] is missing");
    if (table_ == nullptr) fail(section_ + " must be a section [" + section_ + "]", root_.get(name));
  }

  // As section(); inserts `otherwise` if the section is absent.
  void section_or(const char* name, toml::table otherwise) {
    if (!has_section(name)) root_.insert(name, std::move(otherwise));
    section(name);
  }

  // Sets the default of a key in this section.
  template <typename T>
  void set_default(const char* key, const T& value) {
    if (table_ != nullptr && !table_->contains(key)) table_->insert(key, value);
  }

  int64_t integer(const char* key, int64_t low, int64_t high) {
    const toml::node* node = find(key);
    if (node == nullptr) return low;
    if (!node->is_integer()) return fail(path(key) + " must be an integer", node), low;
    const int64_t value = node->as_integer()->get();
    if (value < low || value > high) {
      fail(path(key) + " = " + std::to_string(value) + " is outside " + std::to_string(low) + " to " +
               std::to_string(high),
           node);
    }
    return value;
  }

  std::string text(const char* key, size_t max_length = 64) {
    const toml::node* node = find(key);
    if (node == nullptr) return {};
    if (!node->is_string()) return fail(path(key) + " must be a string", node), std::string{};
    const std::string value = node->as_string()->get();
    if (!is_plain(value, max_length)) {
      fail(path(key) + " must have 1 to " + std::to_string(max_length) + " printable ASCII characters", node);
    }
    return value;
  }

  std::vector<std::string> texts(const char* key, size_t max_count) {
    std::vector<std::string> values;
    const toml::node* node = find(key);
    if (node == nullptr) return values;
    if (!node->is_array()) return fail(path(key) + " must be a list of strings", node), values;
    for (const toml::node& item : *node->as_array()) {
      if (!item.is_string()) return fail(path(key) + " must be a list of strings", node), values;
      values.push_back(item.as_string()->get());
      if (!is_plain(values.back(), kMaxListedLength) || values.size() > max_count) {
        fail(path(key) + " must hold at most " + std::to_string(max_count) + " texts of 1 to " +
                 std::to_string(kMaxListedLength) + " printable ASCII characters",
             node);
        return values;
      }
    }
    return values;
  }

  [[nodiscard]] bool has(const char* key) const { return table_ != nullptr && table_->contains(key); }

  // A list of [x, y], both in [low, high].
  std::vector<PadPlace> places(const char* key, int64_t low, int64_t high) {
    std::vector<PadPlace> values;
    const toml::node* node = find(key);
    const toml::array* list = node == nullptr ? nullptr : node->as_array();
    const auto refuse = [&] {
      fail(
          path(key) + " must be a list of [x, y], integers from " + std::to_string(low) + " to " + std::to_string(high),
          node);
    };
    if (list == nullptr || list->empty()) return refuse(), values;
    for (const toml::node& item : *list) {
      const toml::array* pair = item.as_array();
      if (pair == nullptr || pair->size() != 2) return refuse(), values;
      const auto x = (*pair)[0].value_exact<int64_t>();
      const auto y = (*pair)[1].value_exact<int64_t>();
      if (!x || !y || std::min(*x, *y) < low || std::max(*x, *y) > high) return refuse(), values;
      values.push_back({*x, *y});
    }
    return values;
  }

  // A list of one or more integers, each in [low, high].
  std::vector<int64_t> integers(const char* key, int64_t low, int64_t high) {
    std::vector<int64_t> values;
    const toml::node* node = find(key);
    const toml::array* list = node == nullptr ? nullptr : node->as_array();
    const auto refuse = [&] {
      fail(path(key) + " must be a list of integers from " + std::to_string(low) + " to " + std::to_string(high), node);
    };
    if (list == nullptr || list->empty()) return refuse(), values;
    for (const toml::node& item : *list) {
      const auto value = item.value_exact<int64_t>();
      if (!value || *value < low || *value > high) return refuse(), values;
      values.push_back(*value);
    }
    return values;
  }

  int choice(const char* key, const std::vector<std::string>& allowed) {
    const std::string value = text(key);
    const auto found = std::find(allowed.begin(), allowed.end(), value);
    if (found != allowed.end()) return static_cast<int>(found - allowed.begin());
    std::string list;
    for (const std::string& name : allowed) list += (list.empty() ? "" : ", ") + name;
    fail(path(key) + " = \"" + value + "\" must be one of " + list, table_ == nullptr ? nullptr : table_->get(key));
    return 0;
  }

  // Call after all keys were read: every key that was not requested is unknown.
  void refuse_unknown() {
    for (const auto& [key, node] : root_) {
      const std::string name(key.str());
      if (name == "schema") continue;
      if (!asked_sections_.contains(name)) {
        fail("unknown section [" + name + "]: check the spelling, or remove it", &node);
        continue;
      }
      const toml::table* table = node.as_table();
      if (table == nullptr) continue;
      for (const auto& [inner, value] : *table) {
        if (!asked_keys_.contains(name + "." + std::string(inner.str()))) {
          fail("unknown key " + name + "." + std::string(inner.str()) + ": check the spelling, or remove it", &value);
        }
      }
    }
  }

  // `at`: node in the file whose line the message names.
  void fail(const std::string& what, const toml::node* at = nullptr) {
    if (!error_.empty()) return;
    const std::string line = at == nullptr ? "" : ":" + std::to_string(at->source().begin.line);
    error_ = where_ + line + ": " + what + " (boards/README.md lists the keys)";
  }
  [[nodiscard]] const std::string& error() const { return error_; }

 private:
  // Escapes can produce characters that the file itself may not contain; a zero byte would truncate a name in C and on
  // the wire.
  static bool is_plain(const std::string& value, size_t max_length) {
    return !value.empty() && value.size() <= max_length &&
           std::all_of(value.begin(), value.end(), [](char c) { return c >= ' ' && c <= '~'; });
  }

  const toml::node* find(const char* key) {
    asked_keys_.insert(section_ + "." + key);
    if (table_ == nullptr) return nullptr;
    const toml::node* node = table_->get(key);
    if (node == nullptr) fail("key " + path(key) + " is missing", table_);
    return node;
  }
  [[nodiscard]] std::string path(const char* key) const { return section_ + "." + key; }

  toml::table root_;
  toml::table* table_ = nullptr;
  std::string where_;
  std::string section_;
  std::string error_;
  std::set<std::string> asked_sections_;
  std::set<std::string> asked_keys_;
};

}  // namespace ruffini
