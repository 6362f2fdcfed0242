// The medium below the calibration store: one folder of plain files, with operations whose result after a power cut is
// defined.
//
//   write, create   before sync() the content is undefined: any part of it may be stored, or other bytes
//   rename, remove  are atomic and ordered; durable after sync_folder()
//   sync            makes the content durable; after an error the file is unusable: remove it
//
// tests/cpp/support/crash_medium.h models exactly these rules. Link thread only.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"

namespace ruffini {

// A file being written. The destructor closes it.
class NewFile {
 public:
  NewFile() = default;
  NewFile(const NewFile&) = delete;
  NewFile& operator=(const NewFile&) = delete;
  virtual ~NewFile() = default;
  [[nodiscard]] virtual Status write(std::span<const uint8_t> bytes) = 0;
  [[nodiscard]] virtual Status sync() = 0;
};

// Source of read(): the page cache is sufficient, or the bytes must come from the medium.
enum class ReadFrom { kAnywhere, kMedium };

// Errors: kStorage, with the path and what to do.
class Storage {
 public:
  Storage() = default;
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;
  virtual ~Storage() = default;
  // Names of all entries of the folder, in any order.
  [[nodiscard]] virtual Result<std::vector<std::string>> list() const = 0;
  // Reads the whole file; refuses anything but a plain file.
  [[nodiscard]] virtual Result<std::vector<uint8_t>> read(const std::string& name, ReadFrom from) const = 0;
  // Creates a file with room for n_bytes; refuses an existing name.
  [[nodiscard]] virtual Result<std::unique_ptr<NewFile>> create(const std::string& name, size_t n_bytes) = 0;
  // Replaces the file that has the new name.
  [[nodiscard]] virtual Status rename(const std::string& from, const std::string& to) = 0;
  [[nodiscard]] virtual Status remove(const std::string& name) = 0;
  [[nodiscard]] virtual Status sync_folder() = 0;
  // Succeeds if names can be created and removed, as far as can be checked without doing so.
  [[nodiscard]] virtual Status can_write() const { return Unit{}; }
  // Full path for messages.
  [[nodiscard]] virtual std::string path(const std::string& name) const = 0;
};

}  // namespace ruffini
