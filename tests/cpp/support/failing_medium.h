// A medium in memory of which any call can be made to fail.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "support/crash_medium.h"

namespace ruffini::test {

enum class Call { kList, kRead, kCreate, kWrite, kSync, kRename, kRemove, kSyncFolder, kCanWrite };

class FailingMedium final : public CrashMedium {
 public:
  using CrashMedium::CrashMedium;

  // Whether this call fails; `name` of the file, of a rename the old one.
  using Fails = std::function<bool(Call call, const std::string& name)>;
  Fails fails = [](Call, const std::string&) { return false; };  // NOLINT(misc-non-private-member-variables-in-classes)

  // Calls of one kind, on one name (empty: any): after `n_good` of them all others fail.
  static Fails after(Call wanted, std::string of = "", int n_good = 0) {
    return [wanted, of = std::move(of), n_good](Call call, const std::string& name) mutable {
      return call == wanted && (of.empty() || name == of) && n_good-- <= 0;
    };
  }

  [[nodiscard]] Result<std::vector<std::string>> list() const override {
    if (fails(Call::kList, "")) return error("list");
    return CrashMedium::list();
  }
  [[nodiscard]] Result<Bytes> read(const std::string& name, ReadFrom from) const override {
    if (fails(Call::kRead, name)) return error("read");
    return CrashMedium::read(name, from);
  }
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override {
    if (fails(Call::kCreate, name)) return error("create");
    auto made = CrashMedium::create(name, n_bytes);
    if (!made) return made;
    return std::unique_ptr<NewFile>(std::make_unique<File>(*this, name, std::move(made).value()));
  }
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override {
    return fails(Call::kRename, from) ? Status(error("rename")) : CrashMedium::rename(from, to);
  }
  [[nodiscard]] Status remove(const std::string& name) override {
    return fails(Call::kRemove, name) ? Status(error("remove")) : CrashMedium::remove(name);
  }
  [[nodiscard]] Status sync_folder() override {
    return fails(Call::kSyncFolder, "") ? Status(error("sync_folder")) : CrashMedium::sync_folder();
  }
  [[nodiscard]] Status can_write() const override {
    return fails(Call::kCanWrite, "") ? Status(error("can_write")) : CrashMedium::can_write();
  }

 private:
  static Error error(const std::string& call) { return {ErrorKind::kStorage, call + " failed"}; }

  class File final : public NewFile {
   public:
    File(const FailingMedium& medium, std::string name, std::unique_ptr<NewFile> file)
        : medium_(medium), name_(std::move(name)), file_(std::move(file)) {}
    Status write(std::span<const uint8_t> bytes) override {
      return medium_.fails(Call::kWrite, name_) ? Status(error("write")) : file_->write(bytes);
    }
    Status sync() override { return medium_.fails(Call::kSync, name_) ? Status(error("sync")) : file_->sync(); }

   private:
    const FailingMedium& medium_;
    std::string name_;
    std::unique_ptr<NewFile> file_;
  };
};

// A file that was there before, whole.
inline std::shared_ptr<Inode> kept(Bytes bytes) { return std::make_shared<Inode>(Inode{std::move(bytes), 0, true}); }

}  // namespace ruffini::test
