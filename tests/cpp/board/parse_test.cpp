#include "board/parse.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "support/vectors.h"

namespace ruffini {
namespace {

std::string corpus(const std::string& name) { return std::string(RUFFINI_TEST_DATA_DIR) + "/boards/" + name; }

std::string read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

// tests/py/boards judges the same files.
TEST(ParseBoard, JudgesTheCorpusAsTheHostDoes) {
  int n_good = 0;
  int n_bad = 0;
  for (const auto& row : test::read_vectors(corpus("index.txt"))) {
    const std::string name = row[0];
    const auto board = parse_board(read_file(corpus(name)), name);
    if (name.rfind("good/", 0) == 0) {
      EXPECT_TRUE(board) << (board ? "" : board.error().message);
      ++n_good;
      continue;
    }
    ++n_bad;
    ASSERT_FALSE(board) << name << " was accepted";
    EXPECT_NE(board.error().message.find(name), std::string::npos) << board.error().message;
    EXPECT_NE(board.error().message.find(row.size() > 1 ? row[1] : ""), std::string::npos) << board.error().message;
  }
  EXPECT_GE(n_good, 10);
  EXPECT_GE(n_bad, 40);
}

TEST(ParseBoard, ReadsEveryNumber) {
  const BoardSettings board = parse_board(read_file(corpus("base.toml")), "base").value();
  EXPECT_EQ(board.name, "sample");
  EXPECT_EQ(board.camera.width_px, 320);
  EXPECT_EQ(board.camera.standoff_um, 20'000);
  EXPECT_EQ(board.pad.poisson_1e4, 4'800);
  EXPECT_EQ(board.grid.n_y, 25);
  EXPECT_EQ(board.n_layers, 6);
  EXPECT_EQ(board.window.max_x_um, 20'000);
  EXPECT_EQ(board.markers.lattice.n_x, 19);
  EXPECT_EQ(board.depth.margin_um, 1'200);
  EXPECT_EQ(board.contact.threshold_un, 3'000);
  EXPECT_EQ(board.force_lsb_un, 10);
  EXPECT_EQ(board.stages.size(), 9U);
}

TEST(LoadBoard, TheFolderIsCalledAsTheBoard) {
  const auto folder = std::filesystem::path(testing::TempDir()) / ("parse_test" + std::to_string(::getpid())) / "other";
  std::filesystem::create_directories(folder);
  std::filesystem::copy_file(corpus("base.toml"), folder / "board.toml",
                             std::filesystem::copy_options::overwrite_existing);
  const auto board = load_board(folder.string());
  ASSERT_FALSE(board);
  EXPECT_NE(board.error().message.find("folder is called \"other\""), std::string::npos) << board.error().message;
  std::filesystem::remove_all(folder.parent_path());
  EXPECT_FALSE(load_board(folder.string()));
}

}  // namespace
}  // namespace ruffini
