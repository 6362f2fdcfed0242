#include "image/blobs.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <random>
#include <tuple>
#include <vector>

namespace ruffini {
namespace {

using Sums = std::tuple<int, bool, int64_t, int64_t, int64_t, int64_t, int64_t>;

// Components pixel by pixel, by flooding from the first pixel of each: in the order of these pixels.
std::vector<Sums> flooded(const std::vector<int16_t>& weight, int width, int height) {
  std::vector<uint8_t> seen(weight.size());
  std::vector<Sums> out;
  for (int start = 0; start < width * height; ++start) {
    std::vector<int> waiting = {start};
    Sums sums{};
    auto& [area, touches_border, sum_x, sum_y, sum, weight_x, weight_y] = sums;
    while (!waiting.empty()) {
      const int at = waiting.back();
      waiting.pop_back();
      const auto i = static_cast<size_t>(at);
      if (weight[i] == 0 || seen[i] != 0) continue;
      seen[i] = 1;
      const int x = at % width;
      const int y = at / width;
      ++area;
      touches_border = touches_border || x == 0 || y == 0 || x == width - 1 || y == height - 1;
      sum_x += x;
      sum_y += y;
      sum += weight[i];
      weight_x += int64_t{weight[i]} * x;
      weight_y += int64_t{weight[i]} * y;
      if (x > 0) waiting.push_back(at - 1);
      if (x < width - 1) waiting.push_back(at + 1);
      if (y > 0) waiting.push_back(at - width);
      if (y < height - 1) waiting.push_back(at + width);
    }
    if (area > 0) out.push_back(sums);
  }
  return out;
}

// Arms that only meet further down are one.
TEST(Blobs, JoinsWhatMeetsLater) {
  const std::vector<std::vector<int16_t>> rows = {
      {1, 0, 2, 0, 0, 0, 5, 0}, {1, 0, 2, 0, 0, 0, 0, 0}, {1, 1, 2, 0, 0, 0, 7, 0}};
  Blobs blobs(7, 3);
  ASSERT_EQ(blobs.row(), 8U);
  blobs.start();
  for (size_t y = 0; y < rows.size(); ++y) blobs.add(rows[y], static_cast<int>(y));
  std::vector<Blob> whole;
  for (size_t i = 0; i < blobs.all().size(); ++i) {
    if (blobs.all()[i].parent == static_cast<int>(i)) whole.push_back(blobs.all()[i]);
  }
  ASSERT_EQ(whole.size(), 3U);
  EXPECT_EQ(whole[0].area, 7);
  EXPECT_EQ(whole[0].weight, 10);
  EXPECT_EQ(whole[0].weight_x, 13);
  EXPECT_EQ(whole[0].y, 8);
  EXPECT_TRUE(whole[0].touches_border);
  EXPECT_EQ(whole[1].weight, 5);
  EXPECT_EQ(whole[2].weight, 7);
}

TEST(Blobs, AreThoseOfAFloodForEveryWidthAndEmptyRowsBetween) {
  std::mt19937 random(1);
  for (int width = 1; width <= 40; ++width) {
    for (int picture = 0; picture < 20; ++picture) {
      const int height = 12;
      std::vector<int16_t> weight(static_cast<size_t>(width * height));
      for (size_t i = 0; i < weight.size(); ++i) {
        const bool is_empty_row = i / static_cast<size_t>(width) % 4 == 3 && picture % 2 == 0;
        if (!is_empty_row && random() % 3 != 0) weight[i] = static_cast<int16_t>(1 + random() % 1000);
      }
      Blobs blobs(width, height);
      blobs.start();
      for (int y = 0; y < height; ++y) {
        std::vector<int16_t> row(blobs.row());
        std::copy_n(weight.begin() + y * width, width, row.begin());
        blobs.add(row, y);
      }
      std::vector<Sums> found;
      for (int i = 0; const Blob& b : blobs.all()) {
        if (b.parent == i++) found.emplace_back(b.area, b.touches_border, b.x, b.y, b.weight, b.weight_x, b.weight_y);
      }
      ASSERT_EQ(found, flooded(weight, width, height)) << "width " << width << ", picture " << picture;
    }
  }
}

}  // namespace
}  // namespace ruffini
