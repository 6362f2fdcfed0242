"""Videos beside the twin: films with known statistics, the twin's own film as a recording, refusals."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from ruffini.bench import video_presses
from ruffini.boards import find_board
from ruffini.calibrate.log.videos import VideoColumns
from ruffini.errors import InputError
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit

BALL_MM, MOST_N = 20.0, 6.0
COLUMNS = VideoColumns("load", "N", "frame", r"(.*)_\d")


@pytest.fixture(scope="module")
def unit() -> TwinUnit:
    """The wedge's twin with few elements, and a camera that does not compress."""
    board = find_board("gelsight-wedge")
    twin = load_twin(board)
    mesh = twin.mesh.model_copy(update={"cells_x": 14, "cells_y": 11})
    return TwinUnit.build(board, twin=twin.model_copy(update={"mesh": mesh, "sensor": None}))


@pytest.fixture(scope="module")
def film(unit: TwinUnit) -> Iterator[video_presses.Film]:
    """Few frames; the films beside it have as few."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(video_presses, "DEPTH_STEP_M", 2 * video_presses.DEPTH_STEP_M)
        yield video_presses.twin_film(unit, BALL_MM, (250, 240), MOST_N)


def made(change, noise=0.0, block=0.0) -> video_presses.Film:
    """Eight frames at rest, then one to ten newtons, each of which changes the levels of all pixels by `change`."""
    rng = np.random.default_rng(1)
    force = np.r_[np.zeros(8), np.arange(1.0, 11.0)]
    frames = 100 + force[:, None, None, None] * np.array(change) + noise * rng.standard_normal((18, 64, 64, 3))
    frames += block * (np.arange(64) // 8 % 2)[None, None, :, None]
    return video_presses.Film("made", np.round(frames).astype(np.uint8), force, 8)


def test_statistics_of_a_film_with_known_ones():
    mask = np.zeros((64, 64), bool)
    mask[8:56, 8:56] = True
    found = video_presses.statistics(made((1.0, -2.0, 3.0)), mask)
    assert found.change == pytest.approx([1, 2, 3])
    assert found.changed == pytest.approx(1.0)  # 18 levels and more from 6 N on
    assert found.noise == pytest.approx([0, 0, 0])
    still = video_presses.statistics(made((0.0, 0.0, 0.0), noise=3.0), mask)
    assert still.noise == pytest.approx([3, 3, 3], rel=0.05)
    assert still.blockiness == pytest.approx(1, abs=0.1)
    assert still.changed < 0.05
    assert video_presses.statistics(made((0.0, 0.0, 0.0), noise=1.0, block=6.0), mask).blockiness > 2


def test_a_twins_film_is_recognised_and_another_place_is_not(unit, film, tmp_path):
    mask = video_presses.gel_mask(unit.board)
    at = video_presses.contact_px(video_presses.change_at_most(film), mask)
    assert np.hypot(at[0] - 250, at[1] - 240) < 12
    found = video_presses.compare(film, unit, BALL_MM, mask)
    assert found.correlation.min() > 0.9
    assert found.size == pytest.approx([1, 1, 1], abs=0.1)
    mirrored = film._replace(frames=np.ascontiguousarray(film.frames[:, ::-1]))
    assert video_presses.compare(mirrored, unit, BALL_MM, mask).correlation.min() < 0.5
    path = video_presses.side_by_side(tmp_path / "side.png", [found])
    assert cv2.imread(str(path)).shape == (480, 4 * 640, 3)


def test_a_folder_of_videos_is_read_to_its_largest_force_and_judged(unit, film, tmp_path):
    out = cv2.VideoWriter(str(tmp_path / "ball_0.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    load = [*film.force, 0.0, 0.0]  # and open again
    for i in range(len(load)):
        out.write(film.frames[i] if i < len(film.frames) else film.frames[0])
    out.release()
    rows = [f"{i},{one + 0.5:.4f}" for i, one in enumerate(load)]  # with a zero of its own
    (tmp_path / "ball_0.csv").write_text("\n".join(["frame,load", *rows]) + "\n")
    result, text = video_presses.run(tmp_path, unit.board, unit, COLUMNS, ("ball", BALL_MM), tmp_path / "side.png")
    assert min(result["compared"]["ball_0"]["correlation"]) > 0.9
    real, twin = result["films"].values()
    assert real["levels_per_n"] == pytest.approx(twin["levels_per_n"], rel=0.25)  # less what MJPEG adds
    assert real["blockiness"] > twin["blockiness"]
    assert "ball_0" in text
    with pytest.raises(InputError, match="no recording of it, only of ball"):
        video_presses.run(tmp_path, unit.board, unit, COLUMNS, ("brick", BALL_MM), None)


def test_a_board_without_a_grid_is_refused():
    with pytest.raises(InputError, match="picture_features"):
        video_presses.gel_mask(find_board("gelslim"))
