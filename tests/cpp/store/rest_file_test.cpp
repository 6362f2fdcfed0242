#include "store/rest_file.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>

#include "store/folder_storage.h"

namespace ruffini {
namespace {

constexpr int kWidth = 3;
constexpr int kHeight = 2;

class RestFile : public ::testing::Test {
 protected:
  RestFile() {
    std::string name = (std::filesystem::temp_directory_path() / "rest-XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    medium_ = std::move(FolderStorage::open(folder_.string())).value();
  }
  ~RestFile() override { std::filesystem::remove_all(folder_); }
  RestFile(const RestFile&) = delete;
  RestFile& operator=(const RestFile&) = delete;

  [[nodiscard]] std::vector<uint16_t> loaded() const { return load_rest(*medium_, kWidth, kHeight); }

  std::filesystem::path folder_;
  std::unique_ptr<Storage> medium_;
};

std::vector<uint16_t> picture(uint16_t first) {
  std::vector<uint16_t> out(static_cast<size_t>(3 * kWidth * kHeight));
  for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint16_t>(first + 251 * i);
  return out;
}

TEST_F(RestFile, ComesBackAsItWasKept) {
  EXPECT_TRUE(loaded().empty()) << "none yet";
  ASSERT_TRUE(save_rest(*medium_, picture(7), kWidth, kHeight));
  EXPECT_EQ(loaded(), picture(7));
  std::ofstream(folder_ / "rest.new") << "half of one, from a power cut";
  ASSERT_TRUE(save_rest(*medium_, picture(60'000), kWidth, kHeight));
  EXPECT_EQ(loaded(), picture(60'000));
  EXPECT_TRUE(load_rest(*medium_, kHeight, kWidth).empty()) << "of another camera";
}

TEST_F(RestFile, ADamagedOneIsNone) {
  ASSERT_TRUE(save_rest(*medium_, picture(7), kWidth, kHeight));
  const auto size = std::filesystem::file_size(folder_ / "rest");
  for (uint64_t at = 0; at < size; ++at) {
    std::fstream file(folder_ / "rest", std::ios::in | std::ios::out | std::ios::binary);
    const auto flip = [&] {
      file.seekg(static_cast<std::streamoff>(at));
      const int byte = file.get();
      file.seekp(static_cast<std::streamoff>(at));
      file.put(static_cast<char>(byte ^ 16));
      file.flush();
    };
    flip();
    EXPECT_TRUE(loaded().empty()) << at;
    flip();
  }
  EXPECT_EQ(loaded(), picture(7));
  std::filesystem::resize_file(folder_ / "rest", size - 1);
  EXPECT_TRUE(loaded().empty());
}

}  // namespace
}  // namespace ruffini
