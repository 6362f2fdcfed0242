#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "infer/network.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

std::string file_of(const std::string& name) { return std::string(RUFFINI_TEST_DATA_DIR) + "/networks/" + name; }

std::string bytes_of(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

class NetworkCardTest : public testing::Test {
 protected:
  ~NetworkCardTest() override { std::filesystem::remove(path_); }

  Result<NetworkCard> read(const std::string& bytes) {
    std::ofstream(path_, std::ios::binary) << bytes;
    return read_network_card(path_, board_);
  }
  // The file `means` with a text replaced by one of the same length.
  Result<NetworkCard> read_with(const std::string& from, const std::string& to) {
    std::string bytes = bytes_of(file_of("means.onnx"));
    EXPECT_EQ(from.size(), to.size());
    const size_t at = bytes.find(from);
    EXPECT_NE(at, std::string::npos);
    return read(bytes.replace(at, from.size(), to));
  }

  BoardSettings board_ = test::round_board();
  std::string path_ = testing::TempDir() + "network_card" + std::to_string(::getpid());
};

TEST_F(NetworkCardTest, SaysNamesRangesAndHash) {
  const NetworkCard card = read_network_card(file_of("means.onnx"), board_).value();
  EXPECT_EQ(card.names, (std::vector<std::string>{"blue_un", "green_um"}));
  EXPECT_EQ(card.low, (std::vector<int64_t>{0, -50}));
  EXPECT_EQ(card.high, (std::vector<int64_t>{140'000, 50}));
  EXPECT_EQ(card.sha256.size(), 32U);
  EXPECT_NE(card.sha256, read_network_card(file_of("nan.onnx"), board_).value().sha256);
}

TEST_F(NetworkCardTest, AnotherBoardOpticsOrSizeIsRefused) {
  for (const auto& [from, to] : {std::pair{"round", "other"}, {"test", "lens"}, {"160x120", "120x160"}}) {
    const auto card = read_with(from, to);
    ASSERT_FALSE(card) << from;
    EXPECT_EQ(card.error().kind, ErrorKind::kRefused);
    EXPECT_NE(card.error().message.find(to), std::string::npos) << card.error().message;
  }
}

TEST_F(NetworkCardTest, AMissingFileAndOneThatIsNoNetworkAreErrors) {
  EXPECT_EQ(read_network_card("/no/such/file", board_).error().kind, ErrorKind::kUnavailable);
  for (const std::string& bytes : {std::string(), std::string("no network"), std::string(1'000, '\xff')}) {
    const auto card = read(bytes);
    ASSERT_FALSE(card);
    EXPECT_NE(card.error().message.find("make it with ruffini train"), std::string::npos);
  }
  EXPECT_FALSE(read_with("ruffini-network", "ruffini-notwork"));
}

TEST_F(NetworkCardTest, NamesAndRangesMustFit) {
  for (const auto& [from, to] : {std::pair{"0,-50", "0;-50"},
                                 {"0,-50", "00-50"},
                                 {"0,-50", "0,-5x"},
                                 {"blue_un,green_um", ",reen_um,blue_un"}}) {
    EXPECT_FALSE(read_with(from, to)) << to;
  }
}

// What a card says goes to a terminal and into a message, whose texts must be UTF-8.
TEST_F(NetworkCardTest, NamesAreOfPlainLettersAndErrorsToo) {
  for (const char* name : {"blue un", "blue\x1b[m", "blue\xff\xfe.", "Blue_un"}) {
    EXPECT_FALSE(read_with("blue_un", std::string(name).substr(0, 7))) << name;
  }
  const auto card = read_with("round", "\x1b[2J\xff");
  ASSERT_FALSE(card);
  EXPECT_NE(card.error().message.find("is for board ?[2J?,"), std::string::npos) << card.error().message;
}

// A network says a dozen things of itself. Field 14, of 15 bytes: key "ruffini.x???", value "".
TEST_F(NetworkCardTest, AFileThatSaysNoEndOfThingsIsNotKeptInMemory) {
  std::string more;
  for (int i = 0; i < 100; ++i)
    more += std::string("\x72\x0f\x0a\x0bruffini.") + std::to_string(100 + i) + "\x12" + '\0';
  const std::string whole = bytes_of(file_of("means.onnx"));
  EXPECT_TRUE(read(whole + more.substr(0, 17 * 20)));
  const auto card = read(whole + more);
  ASSERT_FALSE(card);
  EXPECT_NE(card.error().message.find("no network of ruffini"), std::string::npos);
}

TEST_F(NetworkCardTest, AFileOfAnEndlessSizeIsNotReadAndAPipeNotWaitedFor) {
  EXPECT_TRUE(read(bytes_of(file_of("means.onnx"))));
  std::filesystem::resize_file(path_, (uint64_t{1} << 30) + 1);  // a hole: it takes no room
  const auto card = read_network_card(path_, board_);
  ASSERT_FALSE(card);
  EXPECT_NE(card.error().message.find("1 GiB"), std::string::npos);
  std::filesystem::remove(path_);
  ASSERT_EQ(::mkfifo(path_.c_str(), 0600), 0);
  EXPECT_EQ(read_network_card(path_, board_).error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(read_network_card(testing::TempDir(), board_).error().kind, ErrorKind::kUnavailable);
}

// Cut anywhere, or with any byte changed: a card or an error, and no number of outputs that the rest does not have.
TEST_F(NetworkCardTest, HostileFilesAreReadWithoutHarm) {
  const std::string whole = bytes_of(file_of("means.onnx"));
  for (size_t n = 0; n < whole.size(); ++n) EXPECT_FALSE(read(whole.substr(0, n))) << n;
  for (size_t n = 0; n < whole.size(); ++n) {
    for (const char bits : {'\x01', '\x7f', '\xff'}) {
      std::string changed = whole;
      changed[n] = static_cast<char>(changed[n] ^ bits);
      if (const auto card = read(changed)) {
        EXPECT_EQ(card.value().low.size(), card.value().names.size());
        EXPECT_EQ(card.value().high.size(), card.value().names.size());
      }
    }
  }
}

}  // namespace
}  // namespace ruffini
