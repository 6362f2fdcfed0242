"""`ruffini eval markers` on a rendered recording whose motion is known."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.evaluate.markers import evaluate, judge_identity, judge_rest, table
from ruffini.evaluate.warps import Picture, Warp

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
N_STILL, N_MOVED = 30, 12


def dots(shift_px: tuple[float, float], seed: int) -> Picture:
    """The board's lattice of dark dots at its nominal places, all shifted."""
    markers, camera = BOARD.markers, BOARD.camera
    assert markers is not None
    scale = camera.focal_mpx / camera.standoff_um / 1000
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    level = np.full(x.shape, 140.0)
    for j in range(markers.n_y):
        for i in range(markers.n_x):
            at_x = 159.5 + (markers.first_x_um + i * markers.pitch_x_um - BOARD.pad.size_x_um / 2) * scale + shift_px[0]
            at_y = 119.5 + (markers.first_y_um + j * markers.pitch_y_um - BOARD.pad.size_y_um / 2) * scale + shift_px[1]
            level -= 45 * (1 - np.tanh(np.hypot(x - at_x, y - at_y) - 5.5))
    noise = np.random.default_rng(seed).normal(0, 1.0, (*x.shape, 3))
    return np.asarray(np.clip(np.round(level[..., None] + noise), 0, 255), dtype=np.uint8)


@pytest.fixture(scope="module")
def frames() -> list[Picture]:
    """Untouched, then sheared step by step to 12 px."""
    still = [dots((0, 0), seed) for seed in range(N_STILL)]
    return still + [dots((n + 1.0, -0.5 * n), 100 + n) for n in range(N_MOVED)]


def test_a_field_moves_what_it_says(frames: list[Picture]) -> None:
    rng = np.random.default_rng(3)
    warp = Warp.random(rng, (320, 240), 8.4)
    places = np.array([[60.0, 60.0], [160.0, 120.0], [250.0, 200.0]])
    landed = places + warp.forward(places)
    np.testing.assert_allclose(landed + warp.back(landed), places, atol=1e-9)
    spot = np.zeros((240, 320, 1), np.uint8)
    spot[55:66, 55:66] = 200
    moved = np.maximum(warp.render(spot, rng).astype(float) - 20, 0)[30:95, 25:95, 0]
    y, x = np.mgrid[30:95, 25:95]
    center = np.array([(moved * x).sum(), (moved * y).sum()]) / moved.sum()
    np.testing.assert_allclose(center, landed[0], atol=0.2)


def test_the_four_judgements(frames: list[Picture]) -> None:
    result, tracks = evaluate(BOARD, frames, n_fields=2)
    assert result["markers_at_rest"] == 70
    assert result["rest"]["frames"] == N_STILL
    assert result["rest"]["rms_px"] < 0.02
    assert result["warp"]["ruffini"]["rms_px"] < 0.03
    assert result["warp"]["largest_px"] > 2
    assert result["identity"]["torn_frames"] == []
    assert result["order"]["every 4th"]["frames"] == 11
    assert all(row["worst_px"] == 0 for row in result["order"].values())
    expected = [np.hypot(n + 1.0, -0.5 * n) for n in range(N_MOVED)]
    np.testing.assert_allclose(tracks.largest_px[N_STILL:], expected, atol=0.15)
    assert "Lucas-Kanade" in table(result)


def test_a_swapped_marker_is_told(frames: list[Picture]) -> None:
    _, tracks = evaluate(BOARD, frames, n_fields=1)
    tracks.moved_px[33, 3, 4] += 31.0  # one pitch aside: on its neighbour
    tracks.moved_px[7, 2, 2, 0] += 0.12  # below MOVED_PX
    assert judge_identity(tracks)["torn_frames"] == [33]
    assert judge_rest(tracks)["worst_px"] > 0.1


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda f: f[:20], "learns rest from 24"),
        (lambda f: [*f[:30], f[30][:, :300]], "frame 30 is 300x240"),
        (lambda f: [np.full_like(p, 90) for p in f], "no markers of board"),
    ],
)
def test_recordings_that_cannot_be_judged(frames: list[Picture], wrong: object, said: str) -> None:
    assert callable(wrong)
    with pytest.raises(InputError, match=said):
        evaluate(BOARD, wrong(frames), n_fields=1)


def test_the_verb_writes_numbers_and_a_picture(frames: list[Picture], tmp_path: Path) -> None:
    for i, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"{i:03d}.png"), frame)
    picture = tmp_path / "out" / "markers.png"
    arguments = ["eval", "markers", str(tmp_path), "--board", str(BOARD.folder), "--fields", "1", "--json"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(picture)])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert len(result["largest_px"]) == len(frames)
    drawn: npt.NDArray[np.uint8] = np.asarray(cv2.imread(result["picture"]), dtype=np.uint8)
    assert drawn.std() > 10
