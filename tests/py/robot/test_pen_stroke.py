"""The example that draws a line: our feedback, the taught path, and the film of a world."""

import sys
from pathlib import Path

import numpy as np
import pytest
from worlds import BOARD

pytest.importorskip("mujoco", reason="extra [robot]")

from PIL import Image

from ruffini.robot import World
from ruffini.robot.film import Film

sys.path.insert(0, str(Path(__file__).parents[3] / "host" / "examples" / "robot"))


@pytest.fixture
def pen(calibrations, monkeypatch):
    """The example with a short stroke, and fewer frames before it: a faster fall of the same 18 mm."""
    import pen_stroke

    monkeypatch.setattr("ruffini.robot.world.default_calibration", lambda board: calibrations[board.name])
    for name, value in (("AIR", 12), ("FALL", 75), ("FALL_M", 2.4e-4), ("SETTLE", 8), ("STROKE", 80)):
        monkeypatch.setattr(pen_stroke, name, value)
    return pen_stroke


@pytest.mark.parametrize("slope_rad", [-0.1, 0.1])
def test_the_example_draws_uphill_and_downhill_with_the_force_that_is_wanted(pen, slope_rad):
    result = pen.run("wrench", pen.Paper(0.002, slope_rad, 0.4), BOARD)
    assert result.is_success
    assert min(result.tip_n) > 0.3  # no hop
    assert result.most_n < 0.9
    assert result.tip_n[-20:] == pytest.approx([0.5] * 20, abs=0.05)


def test_the_taught_path_draws_on_the_paper_it_was_taught_on_alone(pen, monkeypatch):
    """Nobody feels, and the paper is flat: a few millimetres of stroke show it."""
    monkeypatch.setattr(pen, "AIR", 4)
    monkeypatch.setattr(pen, "STROKE", 20)
    assert pen.run("none", pen.Paper(), BOARD).is_success
    assert pen.run("none", pen.Paper(height_m=0.002), BOARD).is_torn
    above = pen.run("none", pen.Paper(height_m=-0.002), BOARD)
    assert (above.drawn, above.most_n, len(above.tip_n)) == (0.0, 0.0, 20)


def test_a_film_of_a_world_shows_slope_and_line(pen, calibrations, tmp_path):
    film = Film(pen.VIEW_M)
    for slope_rad, line in ((0.0, None), (0.1, None), (0.1, np.array([[-0.02, 0.0, 0.07], [0.02, 0.0, 0.07]]))):
        with World(pen.Paper(slope_rad=slope_rad).model(), {"left": BOARD}, calibrations=calibrations) as world:
            film.take(world, world.step(), "in the air", line)
    film.write(tmp_path / "film.gif")
    pictures = []
    with Image.open(tmp_path / "film.gif") as kept:
        for i in range(kept.n_frames):
            kept.seek(i)
            pictures.append(np.asarray(kept.convert("L"), float)[:, : kept.width // 2])
    flat, sloped, lined = pictures
    row, column = slice(60, 250), np.array([40, 230])  # the paper's upper edge is the first dark row from above
    edge = [np.argmax(picture[row][:, column] < 200, axis=0) for picture in (flat, sloped)]
    assert edge[0][0] == edge[0][1]
    assert edge[1][1] - edge[1][0] > 10
    changed = np.argwhere(np.abs(lined - sloped) > 60)
    assert np.ptp(changed[:, 1]) > 60  # columns
    assert np.ptp(changed[:, 0]) < 6
