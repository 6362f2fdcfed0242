#include "image/pitch_check.h"

#include <gtest/gtest.h>

#include "support/test_board.h"

namespace ruffini {
namespace {

// The board's lattice as a camera sees it that magnifies so many times too much; `step`: every how many-th is there.
std::vector<Marker> seen(const BoardSettings& board, double scale, size_t step = 1) {
  const MarkerSettings& m = board.markers;
  const double px_per_um =
      static_cast<double>(board.camera.focal_mpx) / 1000.0 / static_cast<double>(board.camera.standoff_um);
  std::vector<Marker> markers(static_cast<size_t>(m.lattice.count()));
  for (size_t i = 0; i < markers.size(); i += step) {
    const auto place = [&](int64_t first, int64_t pitch, size_t line) {
      const auto um = static_cast<double>(first + pitch * static_cast<int64_t>(line));
      return ImagePx::from_raw(static_cast<int32_t>((30 + um * px_per_um * scale) * 65'536));
    };
    markers[i].rest_x = place(m.first_x_um, m.pitch_x_um, i % static_cast<size_t>(m.lattice.n_x));
    markers[i].rest_y = place(m.first_y_um, m.pitch_y_um, i / static_cast<size_t>(m.lattice.n_x));
    markers[i].is_absent = markers[i].is_lost = false;
  }
  return markers;
}

TEST(PitchCheck, TakesTheBoardsPitchAndLittleBesides) {
  const BoardSettings board = test::round_board();
  for (const double scale : {0.87, 0.95, 1.0, 1.05, 1.13}) EXPECT_TRUE(pitch_fits(seen(board, scale), board)) << scale;
  for (const double scale : {0.5, 0.7, 0.83, 1.17, 1.4}) EXPECT_FALSE(pitch_fits(seen(board, scale), board)) << scale;
}

TEST(PitchCheck, GoesByTheMarkersThatAreThere) {
  const BoardSettings board = test::round_board();
  EXPECT_TRUE(pitch_fits(seen(board, 1.0, 5), board));
  EXPECT_FALSE(pitch_fits(seen(board, 0.7, 5), board));
  EXPECT_TRUE(pitch_fits(seen(board, 0.7, 20), board)) << "four markers tell nothing";
}

TEST(PitchCheck, ScatteredMarkersGoByTheirOwnPlaces) {
  BoardSettings board = test::round_board();
  const std::vector<Marker> markers = seen(board, 0.7);
  board.markers.is_scattered = true;
  EXPECT_TRUE(pitch_fits(markers, board)) << "nothing to compare with";
  for (int i = 0; i < board.markers.lattice.count(); ++i) {
    const int column = i % board.markers.lattice.n_x;
    const int row = i / board.markers.lattice.n_x;
    board.markers.places.push_back({board.markers.first_x_um + column * board.markers.pitch_x_um,
                                    board.markers.first_y_um + row * board.markers.pitch_y_um});
  }
  EXPECT_FALSE(pitch_fits(markers, board));
}

}  // namespace
}  // namespace ruffini
