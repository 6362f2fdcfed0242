// The medium of support/crash_medium.h with calls that fail, and power that goes in the middle of one.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "dice.h"
#include "event_log.h"
#include "faults.h"
#include "support/crash_medium.h"

namespace ruffini::sim {

// Thrown where the power goes.
struct PowerCut {};

// What outlives the daemon.
class Disk {
 public:
  Disk(Dice dice, Swarm& swarm) : dice_(dice), swarm_(swarm), medium_(std::make_unique<test::CrashMedium>()) {}

  // The power goes at the n-th call from now on.
  void cut_at_call(uint64_t n) { calls_to_cut_ = n; }
  [[nodiscard]] bool is_failing() const { return is_failing_; }
  void set_failing(bool is_failing) { is_failing_ = is_failing; }
  [[nodiscard]] bool has_failed() const { return has_failed_; }
  void forget_failures() { has_failed_ = false; }

  // What the medium holds after the power was gone.
  void lose_power() {
    test::Names names = medium_->names_after(dice_.below(medium_->n_pending() + 1));
    for (auto& [name, inode] : names) {
      if (!inode->is_synced) inode = std::make_shared<test::Inode>(test::Inode{left_of(*inode), 0, true});
    }
    medium_ = std::make_unique<test::CrashMedium>(std::move(names));
    calls_to_cut_ = 0;
  }

  // Before each call: the power may go, the call may fail.
  [[nodiscard]] bool fails() {
    if (calls_to_cut_ > 0 && --calls_to_cut_ == 0) {
      swarm_.count(Fault::kCutInStore);
      throw PowerCut();
    }
    if (!is_failing_ || !swarm_.strikes(Fault::kDiskError, 250'000)) return false;
    has_failed_ = true;
    return true;
  }
  test::CrashMedium& medium() { return *medium_; }
  [[nodiscard]] static Error error() { return {ErrorKind::kStorage, "medium: I/O error: replace it"}; }

 private:
  // An unsynced file: nothing, a part, its end missing or of something else.
  test::Bytes left_of(const test::Inode& inode) {
    test::Bytes bytes = inode.bytes;
    const uint64_t kind = dice_.below(5);
    const size_t from = dice_.below(bytes.size() + 1);
    if (kind == 0) bytes.clear();
    if (kind == 1) bytes.resize(from);
    for (size_t i = from; kind > 2 && i < bytes.size(); ++i) {
      bytes[i] = kind == 3 ? uint8_t{0} : static_cast<uint8_t>(dice_.next());
    }
    return bytes;
  }

  Dice dice_;
  Swarm& swarm_;
  std::unique_ptr<test::CrashMedium> medium_;
  uint64_t calls_to_cut_ = 0;
  bool is_failing_ = false;
  bool has_failed_ = false;
};

// What the store holds.
class DiskEnd final : public Storage {
 public:
  explicit DiskEnd(Disk& disk) : disk_(disk) {}
  [[nodiscard]] Result<std::vector<std::string>> list() const override {
    if (disk_.fails()) return Disk::error();
    return disk_.medium().list();
  }
  [[nodiscard]] Result<test::Bytes> read(const std::string& name, ReadFrom from) const override {
    if (disk_.fails()) return Disk::error();
    return disk_.medium().read(name, from);
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    if (disk_.fails()) return Disk::error();
    auto made = disk_.medium().create(name, n_bytes);
    if (!made) return made.error();
    return std::unique_ptr<NewFile>(std::make_unique<File>(disk_, std::move(made).value()));
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    if (disk_.fails()) return Disk::error();
    return disk_.medium().rename(from, to);
  }
  [[nodiscard]] Status remove(const std::string& name) override {
    if (disk_.fails()) return Disk::error();
    return disk_.medium().remove(name);
  }
  [[nodiscard]] Status sync_folder() override {
    if (disk_.fails()) return Disk::error();
    return disk_.medium().sync_folder();
  }
  [[nodiscard]] std::string path(const std::string& name) const override { return "medium/" + name; }

 private:
  struct File final : NewFile {
    File(Disk& disk, std::unique_ptr<NewFile> file) : disk_(disk), file_(std::move(file)) {}
    [[nodiscard]] Status write(std::span<const uint8_t> bytes) override {
      const size_t n_first = bytes.size() / 2;
      const Status begun = file_->write(bytes.first(n_first));
      if (disk_.fails()) return Disk::error();
      return begun ? file_->write(bytes.subspan(n_first)) : begun;
    }
    [[nodiscard]] Status sync() override {
      if (disk_.fails()) return Disk::error();
      return file_->sync();
    }
    Disk& disk_;
    std::unique_ptr<NewFile> file_;
  };

  Disk& disk_;
};

}  // namespace ruffini::sim
