#include "store/slot_store.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

class SlotStoreTest : public testing::Test {
 protected:
  SlotStoreTest() : folder_(fs::path(testing::TempDir()) / ("slot_store_test" + std::to_string(::getpid()))) {
    fs::remove_all(folder_);
  }
  ~SlotStoreTest() override { fs::remove_all(folder_); }
  [[nodiscard]] SlotStore open() const { return SlotStore::open(folder_.string()).value(); }
  [[nodiscard]] bool has(const char* name) const { return fs::exists(folder_ / name); }
  fs::path folder_;
};

TEST_F(SlotStoreTest, AnEmptyStoreHoldsNothing) { EXPECT_EQ(open().load().value(), Bytes{}); }

TEST_F(SlotStoreTest, TheNewestIsInForceAndTheOneBeforeIsKept) {
  const SlotStore store = open();
  ASSERT_TRUE(store.install(Bytes(100'000, 1)));
  ASSERT_TRUE(store.install(Bytes(50, 2)));
  EXPECT_EQ(store.load().value(), Bytes(50, 2));
  EXPECT_EQ(open().load().value(), Bytes(50, 2));
  EXPECT_EQ(fs::file_size(folder_ / "previous.safetensors"), 100'000U);
  EXPECT_FALSE(has("incoming.tmp"));
}

TEST_F(SlotStoreTest, AnUploadThatWasCutOffIsForgotten) {
  ASSERT_TRUE(open().install(Bytes(10, 1)));
  std::ofstream(folder_ / "incoming.tmp") << "half";
  EXPECT_EQ(open().load().value(), Bytes(10, 1));
  EXPECT_FALSE(has("incoming.tmp"));
}

TEST_F(SlotStoreTest, AFullMediumLeavesWhatIsInForce) {
  const SlotStore store = open();
  ASSERT_TRUE(store.install(Bytes(10, 1)));
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{4'096, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const Status installed = store.install(Bytes(100'000, 2));
  setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_FALSE(installed);
  EXPECT_EQ(installed.error().kind, ErrorKind::kStorage);
  EXPECT_NE(installed.error().message.find("incoming.tmp"), std::string::npos) << installed.error().message;
  EXPECT_EQ(store.load().value(), Bytes(10, 1));
}

TEST_F(SlotStoreTest, AFolderThatCannotBeMadeIsNamed) {
  std::ofstream(folder_) << "a file";
  const auto store = SlotStore::open(folder_.string());
  ASSERT_FALSE(store);
  EXPECT_EQ(store.error().kind, ErrorKind::kStorage);
  EXPECT_NE(store.error().message.find(folder_.string()), std::string::npos);
}

}  // namespace
}  // namespace ruffini
