// The medium below the calibration store: one folder of plain files, with the calls whose meaning at a power cut is known.
//
//   write, create   nothing is certain of the content before sync(): any part of it may be there, or other bytes
//   rename, remove  happen as a whole or not at all, in their order; certain after sync_folder()
//   sync            the content is on the medium; after an error the file is worth nothing: remove it
//
// tests/cpp/support/crash_medium.h is that sentence as a model. Link thread only.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"

namespace ruffini {

// A file that is being written. Its end closes it.
class NewFile {
 public:
  NewFile() = default;
  NewFile(const NewFile&) = delete;
  NewFile& operator=(const NewFile&) = delete;
  virtual ~NewFile() = default;
  [[nodiscard]] virtual Status write(std::span<const uint8_t> bytes) = 0;
  [[nodiscard]] virtual Status sync() = 0;
};

// Where read() has its bytes from: the page cache will do, or only what the medium kept.
enum class ReadFrom { kAnywhere, kMedium };

// Errors: kStorage, with the path and what to do.
class Storage {
 public:
  Storage() = default;
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;
  virtual ~Storage() = default;
  // Names of all that is in the folder, in no order.
  [[nodiscard]] virtual Result<std::vector<std::string>> list() const = 0;
  // The whole file; refuses what is not a plain file.
  [[nodiscard]] virtual Result<std::vector<uint8_t>> read(const std::string& name, ReadFrom from) const = 0;
  // A new file with room for so many bytes; refuses a name that is there.
  [[nodiscard]] virtual Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) = 0;
  // In the place of what had the new name.
  [[nodiscard]] virtual Status rename(const std::string& from, const std::string& to) = 0;
  [[nodiscard]] virtual Status remove(const std::string& name) = 0;
  [[nodiscard]] virtual Status sync_folder() = 0;
  // Whether names can be made and removed there, as far as can be told without doing so.
  [[nodiscard]] virtual Status can_write() const { return Unit{}; }
  // For messages.
  [[nodiscard]] virtual std::string path(const std::string& name) const = 0;
};

}  // namespace ruffini
