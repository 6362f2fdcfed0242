// A medium on which the power can be cut: store/storage.h as a model that keeps what is certain apart from what is not.
#pragma once

#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "store/storage.h"

namespace ruffini::test {

using Bytes = std::vector<uint8_t>;

// One file, by whatever names.
struct Inode {
  Bytes bytes;
  size_t n_reserved = 0;
  bool is_synced = true;
};
using Names = std::map<std::string, std::shared_ptr<Inode>>;

// What happened to the names since the last sync_folder(), in order: a name got a file, or lost it.
struct NameChange {
  std::optional<std::string> removed;
  std::optional<std::pair<std::string, std::shared_ptr<Inode>>> given;
};

class CrashMedium : public Storage {
 public:
  CrashMedium() = default;
  explicit CrashMedium(Names names) : durable_(names), names_(std::move(names)) {}

  // Told before and after each call that changes the medium: here the power may be cut.
  std::function<void(const CrashMedium&)> watch = [](const CrashMedium&) {};

  [[nodiscard]] const Names& names() const { return names_; }
  // The names that a cut now may leave: all that is certain, and the first n changes after that.
  [[nodiscard]] size_t n_pending() const { return pending_.size(); }
  [[nodiscard]] Names names_after(size_t n_changes) const {
    Names out = durable_;
    for (size_t i = 0; i < n_changes; ++i) {
      if (pending_[i].removed) out.erase(*pending_[i].removed);
      if (pending_[i].given) out[pending_[i].given->first] = pending_[i].given->second;
    }
    return out;
  }

  [[nodiscard]] Result<std::vector<std::string>> list() const override {
    std::vector<std::string> out;
    for (const auto& [name, inode] : names_) out.push_back(name);
    return out;
  }
  [[nodiscard]] Result<Bytes> read(const std::string& name, ReadFrom /*from*/) const override {
    const auto found = names_.find(name);
    if (found == names_.end()) return failed(name);
    return found->second->bytes;
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    if (names_.count(name) != 0) return failed(name);
    auto inode = std::make_shared<Inode>(Inode{{}, n_bytes, false});
    change({{}, {{name, inode}}});
    return std::unique_ptr<NewFile>(std::make_unique<File>(*this, inode));
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    const auto found = names_.find(from);
    if (found == names_.end()) return failed(from);
    change({from, {{to, found->second}}});
    return Unit{};
  }
  [[nodiscard]] Status remove(const std::string& name) override {
    if (names_.count(name) == 0) return failed(name);
    change({name, {}});
    return Unit{};
  }
  [[nodiscard]] Status sync_folder() override {
    watch(*this);
    durable_ = names_;
    pending_.clear();
    watch(*this);
    return Unit{};
  }
  [[nodiscard]] std::string path(const std::string& name) const override { return "medium/" + name; }

 private:
  class File final : public NewFile {
   public:
    File(CrashMedium& medium, std::shared_ptr<Inode> inode) : medium_(medium), inode_(std::move(inode)) {}
    Status write(std::span<const uint8_t> bytes) override {
      medium_.watch(medium_);
      inode_->bytes.insert(inode_->bytes.end(), bytes.begin(), bytes.end());
      inode_->is_synced = false;
      medium_.watch(medium_);
      return Unit{};
    }
    Status sync() override {
      medium_.watch(medium_);
      inode_->is_synced = true;
      medium_.watch(medium_);
      return Unit{};
    }

   private:
    CrashMedium& medium_;
    std::shared_ptr<Inode> inode_;
  };

  static Error failed(const std::string& name) { return {ErrorKind::kStorage, "medium/" + name + ": no such call"}; }

  void change(NameChange change) {
    watch(*this);
    if (change.removed) names_.erase(*change.removed);
    if (change.given) names_[change.given->first] = change.given->second;
    pending_.push_back(std::move(change));
    watch(*this);
  }

  Names durable_;
  Names names_;
  std::vector<NameChange> pending_;
};

// What a cut may leave of a file that was not synced. `visit` gets each content once, some thousand for each sector.
inline void torn(const Inode& file, size_t step, const std::function<void(const Bytes&)>& visit) {
  constexpr size_t kSector = 512;
  const size_t n = std::max(file.bytes.size(), file.n_reserved);
  Bytes whole = file.bytes;
  whole.resize(n);
  visit({});     // nothing of it
  visit(whole);  // all of it
  Bytes garbage(n);
  for (size_t i = 0; i < n; ++i) garbage[i] = static_cast<uint8_t>((i * 2'654'435'761U) >> 13);
  const auto mix = [&](size_t from, size_t to, const Bytes& other) {  // whole, but [from, to) is of `other`
    Bytes out = whole;
    std::copy(other.begin() + static_cast<ptrdiff_t>(from), other.begin() + static_cast<ptrdiff_t>(to),
              out.begin() + static_cast<ptrdiff_t>(from));
    return out;
  };
  const Bytes zeros(n);
  const Bytes ones(n, 0xFF);
  for (size_t t = 0; t < file.bytes.size(); t += step) {
    const size_t sector_end = std::min((t / kSector + 1) * kSector, n);
    if (t > 0) visit(Bytes(whole.begin(), whole.begin() + static_cast<ptrdiff_t>(t)));  // short
    visit(mix(t, n, zeros));                                                            // its end never came
    visit(mix(t, n, ones));                                                             // erased flash
    visit(mix(t, n, garbage));                                                          // what was there before
    visit(mix(t, sector_end, garbage));  // a torn sector, later ones came
    visit(mix(t, sector_end, zeros));
    visit(mix(0, t + 1, zeros));  // out of order: its begin is missing
    visit(mix(0, t + 1, garbage));
  }
}

}  // namespace ruffini::test
