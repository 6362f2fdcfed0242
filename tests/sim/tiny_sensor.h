// A sensor so small that its real frame path takes microseconds: six dots on 40 x 28 pixels, whose mean shift is the force.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "board/settings.h"

namespace ruffini::sim {

using Bytes = std::vector<uint8_t>;

inline constexpr char kSerial[] = "0042";
inline constexpr uint64_t kTouches = 5;  // 0: nothing touches; others move the dots by half a pixel each

// What the camera shows. Below kTouches: the touch.
enum Picture : uint8_t { kDarkPicture = kTouches, kGlarePicture, kNoisePicture, kPictures };

// A calibration file as a host may send it.
struct Table {
  std::string name;
  Bytes bytes;
  std::string sha256;
  uint32_t id = 0;  // as in stamps
  bool is_good = false;
  // Along x, uN, by picture, where a frame that shows it may call its force valid.
  std::array<int64_t, kTouches> force_un{};
  std::array<bool, kTouches> is_valid{};
};

struct TinySensor {
  TinySensor();

  BoardSettings board;
  std::array<Bytes, kPictures> pictures;  // B, G, R
  std::vector<Table> tables;              // the good ones first
  size_t n_good = 0;
  std::map<std::string, size_t> by_sha256;
  std::map<uint32_t, size_t> by_id;

  // nullptr: no good table has it.
  [[nodiscard]] const Table* good_by_id(uint32_t id) const;
  [[nodiscard]] const Table* good_by_sha256(const std::string& sha256) const;

 private:
  void draw();
  void make_tables();
  void add(const std::string& name, Bytes bytes, bool is_good);
  void measure(Table& table) const;
};

// A force further off than this is wrong: 1 % of the tables' full scale.
inline constexpr int64_t kForceLimitUn = 200'000;

}  // namespace ruffini::sim
