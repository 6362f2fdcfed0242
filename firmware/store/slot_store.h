// The calibration on the medium: one folder, three names.
//
//   calibration.safetensors   in force
//   previous.safetensors      what was in force before
//   incoming.tmp              an upload that is not finished; removed at start
//
// install(): temporary file, fsync, read back from the medium, compare, rename, fsync of the folder. After
// any crash the old or the new file is in force, whole. Link thread only.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"

namespace ruffini {

class SlotStore {
 public:
  // Creates the folder where it is missing. Errors: kStorage with path and remedy.
  [[nodiscard]] static Result<SlotStore> open(const std::string& folder);

  // The file in force; an empty vector where there is none.
  [[nodiscard]] Result<std::vector<uint8_t>> load() const;
  // What was in force before it; an empty vector where there was nothing.
  [[nodiscard]] Result<std::vector<uint8_t>> load_previous() const;
  // Makes `bytes` the file in force, durably.
  [[nodiscard]] Status install(std::span<const uint8_t> bytes) const;

 private:
  explicit SlotStore(std::string folder) : folder_(std::move(folder)) {}
  [[nodiscard]] Result<std::vector<uint8_t>> load(const char* name) const;
  [[nodiscard]] Status put_in_force(const std::string& incoming) const;
  [[nodiscard]] std::string path(const char* name) const { return folder_ + "/" + name; }

  std::string folder_;
};

}  // namespace ruffini
