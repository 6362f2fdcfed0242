#include "board/parse.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/stages.h"
#include "support/vectors.h"

namespace ruffini {
namespace {

using namespace std::string_literals;
using Lines = std::vector<std::string>;

constexpr const char* kSuffix = " (boards/README.md lists the keys)";

std::string data_file(const std::string& name) { return std::string(RUFFINI_TEST_DATA_DIR) + "/boards/" + name; }

std::string read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string base() { return read_file(data_file("base.toml")); }

Lines lines_of(const std::string& text) {
  std::istringstream in(text);
  Lines lines;
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::string text_of(const Lines& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

// The lines of a section and its header, which all but the first section "" have.
std::pair<Lines::iterator, Lines::iterator> section_of(Lines& lines, const std::string& name) {
  const auto first = name.empty() ? lines.begin() : std::find(lines.begin(), lines.end(), "[" + name + "]");
  if (first == lines.end()) return {first, first};
  const auto is_header = [](const std::string& line) { return line.rfind('[', 0) == 0; };
  return {first, std::find_if(first + (name.empty() ? 0 : 1), lines.end(), is_header)};
}

// The forms of an edit: cases.txt.
void edit_lines(const std::string& edit, Lines& lines) {
  const bool is_drop = edit.front() == '-';
  if (edit.front() == '+') {
    Lines optional = lines_of(read_file(data_file("optional.toml")));
    const auto [first, last] = section_of(optional, edit.substr(2, edit.size() - 3));
    ASSERT_NE(first, last) << edit;
    lines.insert(lines.end(), first, last);
    return;
  }
  if (edit.rfind("-[", 0) == 0) {
    const auto [first, last] = section_of(lines, edit.substr(2, edit.size() - 3));
    ASSERT_NE(first, last) << edit;
    lines.erase(first, last);
    return;
  }
  const std::string line = is_drop ? edit.substr(1) : edit;
  const std::string path = line.substr(0, line.find(" = "));
  const size_t dot = path.find('.');
  const std::string section = dot == std::string::npos ? "" : path.substr(0, dot);
  const std::string key = dot == std::string::npos ? path : path.substr(dot + 1);
  if (!section.empty() && section_of(lines, section).first == lines.end()) lines.push_back("[" + section + "]");
  const auto [first, last] = section_of(lines, section);
  auto place = std::find_if(first, last, [&](const std::string& l) { return l.rfind(key + " = ", 0) == 0; });
  ASSERT_FALSE(is_drop && place == last) << edit;
  if (place == last) {
    place = section.empty() ? first : first + 1;
  } else {
    place = lines.erase(place);
  }
  if (!is_drop) lines.insert(place, key + line.substr(path.size()));
}

std::string edited(const std::string& edits) {
  Lines lines = lines_of(base());
  for (size_t at = 0; at < edits.size();) {
    const size_t end = std::min(edits.find("; ", at), edits.size());
    edit_lines(edits.substr(at, end - at), lines);
    at = end + 2;
  }
  return text_of(lines);
}

// The parser's sentence without the file; the line that it names, 0: none.
struct Refusal {
  std::string sentence;
  size_t line = 0;
};

Refusal refusal(const std::string& name, const std::string& text) {
  const auto board = parse_board(text, name);
  EXPECT_FALSE(board_json(text, name)) << name;
  if (board) {
    ADD_FAILURE() << name << " was accepted:\n" << text;
    return {};
  }
  std::smatch parts;
  const std::string message = board.error().message;
  EXPECT_TRUE(std::regex_match(message, parts, std::regex(name + "(?::(\\d+))?: (.*)"))) << message;
  return {parts[2], parts[1].matched ? std::stoul(parts[1]) : 0};
}

std::string with(std::string text, const std::string& find, const std::string& put) {
  for (size_t at = 0; (at = text.find(find, at)) != std::string::npos; at += put.size()) {
    text.replace(at, find.size(), put);
  }
  return text;
}

std::string all_stages() {
  std::string list;
  for (const std::string& name : stage_names()) list += (list.empty() ? "" : ", ") + name;
  return list;
}

// "a, b or c"
std::string feature_stages() {
  std::string list;
  std::string last;
  for (const StageEntry& entry : stage_table()) {
    if (entry.features.name.empty()) continue;
    if (!last.empty()) list += (list.empty() ? "" : ", ") + last;
    last = entry.name;
  }
  return list + " or " + last;
}

// The library's own words follow "not TOML"; the list of keys is named where a key is wrong.
bool says(const Refusal& refused, const std::string& expected) {
  if (expected == "not TOML") return refused.line > 0 && refused.sentence.rfind("not TOML: ", 0) == 0;
  return refused.sentence == expected || refused.sentence == expected + kSuffix;
}

TEST(ParseBoard, AcceptsAndRefusesTheCases) {
  int n_good = 0;
  int n_bad = 0;
  int n_with_line = 0;
  for (const auto& row : test::read_vectors(data_file("cases.txt"))) {
    const std::string& name = row.at(1);
    const std::string text = edited(row.size() > 2 ? row[2] : "");
    if (row[0] == "good") {
      const auto board = parse_board(text, name);
      EXPECT_TRUE(board) << board.error().message << "\n" << text;
      EXPECT_TRUE(board_json(text, name)) << name;
      ++n_good;
      continue;
    }
    ++n_bad;
    const Refusal refused = refusal(name, text);
    const std::string expected = with(with(row.at(3), "{stages}", all_stages()), "{features}", feature_stages());
    EXPECT_TRUE(says(refused, expected)) << name << ": " << refused.sentence;
    if (refused.line == 0) continue;
    ++n_with_line;
    // A value is refused on its own line, an absent key on that of its section.
    const std::string line = lines_of(text).at(refused.line - 1);
    std::smatch parts;
    if (std::regex_search(refused.sentence, parts, std::regex("^key (\\w+)\\.\\w+ is missing"))) {
      EXPECT_EQ(line, "[" + parts[1].str() + "]") << name;
    } else if (std::regex_search(refused.sentence, parts, std::regex("^(?:unknown key )?\\w+\\.(\\w+) "))) {
      EXPECT_EQ(line.rfind(parts[1].str() + " = ", 0), 0U) << name << ": " << line;
    }
  }
  EXPECT_GE(n_good, 48);
  EXPECT_GE(n_bad, 150);
  EXPECT_GE(n_with_line, 70);
}

std::string filled(size_t n_bytes) {
  const std::string text = base();
  return text + std::string(n_bytes - text.size(), '#');
}

TEST(ParseBoard, AcceptsOtherSpellings) {
  const std::string text = base();
  const std::pair<const char*, std::string> cases[] = {
      {"comments", "# a comment\n" + with(text, "[pad]", "# another\n[pad]  # here")},
      {"carriage returns", with(text, "\n", "\r\n")},
      {"tabs", with(text, " = ", "\t=\t")},
      {"inline table", "contact = { threshold_un = 1, min_nodes = 1 }\n" + edited("-[contact]")},
      {"dotted key", "field.force_lsb_un = 20\n" + edited("-[field]")},
      {"no final newline", text.substr(0, text.size() - 1)},
      {"8000 bytes", filled(8'000)},
  };
  for (const auto& [name, file] : cases) {
    const auto board = parse_board(file, name);
    EXPECT_TRUE(board) << board.error().message;
  }
}

TEST(ParseBoard, RefusesOtherTexts) {
  const std::string text = base();
  const std::string not_ascii = "a character that is not plain ASCII";
  const std::string no_field = "field must be a section [field]";
  std::string deep_keys = "chain";
  for (int i = 0; i < 3'000; ++i) deep_keys += ".a";
  const struct {
    const char* name;
    std::string text;
    std::string sentence;
    size_t line;
  } cases[] = {
      {"empty", "", "schema must be 1", 0},
      {"only a comment", "# nothing\n", "schema must be 1", 0},
      {"byte-order mark", "\xEF\xBB\xBF" + text, "starts with a byte-order mark: save it without one", 0},
      {"UTF-16", "\xFF\xFEs\0c\0"s, not_ascii, 1},
      {"UTF-8", "# gr\xC3\xBCn\n" + text, not_ascii, 1},
      {"Latin-1", "\n# gr\xFCn\n" + text, not_ascii, 2},
      {"odd space", with(text, "schema = ", "schema =\xC2\xA0"), not_ascii, 1},
      {"zero byte", text + "\0"s, not_ascii, 63},
      {"lone carriage returns", with(text, "\n", "\r"), "not TOML", 1},
      {"prose", "this is not TOML\n", "not TOML", 1},
      {"JSON", "{\"schema\": 1}\n", "not TOML", 1},
      {"a key twice", with(text, "[pad]\n", "[pad]\nsize_x_um = 20000\n"), "not TOML", 20},
      {"a section twice", text + "\n[pad]\nsize_x_um = 1\n", "not TOML", 64},
      {"deep lists", "chain = " + std::string(2'000, '[') + std::string(2'000, ']') + "\n" + text, "not TOML", 1},
      {"deep keys", deep_keys + " = 1\n" + text, "unknown section [chain]: check the spelling, or remove it", 1},
      {"unknown section", text + "\n[optics]\nx = 1\n", "unknown section [optics]: check the spelling, or remove it",
       64},
      {"unknown key at the top", "name = 1\n" + text, "unknown section [name]: check the spelling, or remove it", 1},
      {"misspelt key", with(text, "thickness_um", "thicknes_um"), "key pad.thickness_um is missing", 18},
      {"a number for a section", "field = 1\n" + edited("-[field]"), no_field, 1},
      {"a list of sections", with(text, "[field]", "[[field]]"), no_field, 57},
      {"a dotted key alone", "field.force = 20\n" + edited("-[field]"), "key field.force_lsb_un is missing", 1},
      {"8001 bytes", filled(8'001), "has more than 8000 bytes: move comments into the board's README.md", 0},
  };
  for (const auto& one : cases) {
    const Refusal refused = refusal(one.name, one.text);
    EXPECT_TRUE(says(refused, one.sentence)) << one.name << ": " << refused.sentence;
    EXPECT_EQ(refused.line, one.line) << one.name;
  }
}

TEST(ParseBoard, NamesTheFirstThingThatIsWrong) {
  const auto board = parse_board(edited("grid.n_y = 1; pad.hardness = 30; camera.width_px = 4097"), "a/board.toml");
  ASSERT_FALSE(board);
  EXPECT_EQ(board.error().message, "a/board.toml:10: camera.width_px = 4097 is outside 16 to 4096"s + kSuffix);
}

TEST(ParseBoard, ReadsEveryNumber) {
  const BoardSettings board = parse_board(base(), "base").value();
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

TEST(ParseBoard, DefaultsOfAbsentKeys) {
  const BoardSettings board = parse_board(edited("+[light]"), "base").value();
  EXPECT_EQ(board.pad.stiffness_sigma_1e3, 100);
  EXPECT_EQ(board.contact.steady_frames, 1);
  EXPECT_FALSE(board.markers.is_scattered);
  EXPECT_EQ(board.depth.source, DepthSource::kLight);
  EXPECT_FALSE(board.light.alternates);
  EXPECT_EQ(board.calibration_kb, 131'072);
  // tests/py/boards compares the JSON with an independent reader of TOML.
  const std::string json = board_json(edited("+[light]"), "base").value();
  for (const char* one : {R"("stiffness_sigma_1e3" : 100)", R"("layout" : "lattice")", R"("source" : "light")",
                          R"("alternation" : "none")", R"("calibration_kb" : 131072)"}) {
    EXPECT_NE(json.find(one), std::string::npos) << one;
  }
}

TEST(LoadBoard, TheFolderIsCalledAsTheBoard) {
  const auto folder = std::filesystem::path(testing::TempDir()) / ("parse_test" + std::to_string(::getpid())) / "other";
  std::filesystem::create_directories(folder);
  std::filesystem::copy_file(data_file("base.toml"), folder / "board.toml",
                             std::filesystem::copy_options::overwrite_existing);
  const auto board = load_board(folder.string());
  ASSERT_FALSE(board);
  EXPECT_NE(board.error().message.find("folder is called \"other\""), std::string::npos) << board.error().message;
  std::filesystem::remove_all(folder.parent_path());
  EXPECT_FALSE(load_board(folder.string()));
}

}  // namespace
}  // namespace ruffini
