// Implements the medium of the store (store/storage.h) as a folder of the file system. Names cannot leave the folder:
// links are refused, and the folder's descriptor is held open.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "base/unique_fd.h"
#include "store/storage.h"

namespace ruffini {

// Reads one file; the path may be a link. Errors: kStorage with path and remedy.
[[nodiscard]] Result<std::vector<uint8_t>> read_file(const std::string& path);

class FolderStorage final : public Storage {
 public:
  // Creates the folder if it is missing. A read-only folder is accepted. Errors: kStorage with path and remedy.
  [[nodiscard]] static Result<std::unique_ptr<Storage>> open(const std::string& folder);

  [[nodiscard]] Result<std::vector<std::string>> list() const override;
  [[nodiscard]] Result<std::vector<uint8_t>> read(const std::string& name, ReadFrom from) const override;
  [[nodiscard]] Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) override;
  [[nodiscard]] Status rename(const std::string& from, const std::string& to) override;
  [[nodiscard]] Status remove(const std::string& name) override;
  [[nodiscard]] Status sync_folder() override;
  [[nodiscard]] Status can_write() const override;
  [[nodiscard]] std::string path(const std::string& name) const override { return folder_ + "/" + name; }

 private:
  FolderStorage(std::string folder, UniqueFd fd) : folder_(std::move(folder)), fd_(std::move(fd)) {}

  std::string folder_;
  UniqueFd fd_;
};

}  // namespace ruffini
