"""The stage picture_features and the wrench of its features are the mirror's, bit for bit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.feature_wrench import FeatureWrench
from mirror.fixed import Saturations
from mirror.light import reciprocal, relative_change, rest_image
from mirror.picture_features import cells, features
from odd_boards import small_board
from test_targets import tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError

WIDTH, HEIGHT, N_REST = 122, 91, 3
NOT_MEASURED, VALID = 0, 1
CORNERS = {
    "upright": [[10, 5], [110, 5], [110, 85], [10, 85]],
    "perspective": [[7, 3], [101, 12], [117, 71], [4, 88]],
    "turned": [[60, 2], [119, 45], [58, 89], [3, 44]],
    "whole": [[0, 0], [121, 0], [121, 90], [0, 90]],
}


def board_text(corners: list[list[int]], n_x: int = 5, n_y: int = 4) -> str:
    text = small_board(width=WIDTH, height=HEIGHT, step=1)
    section = f"[picture_features]\ncorners_px = {corners}\nn_x = {n_x}\nn_y = {n_y}\n"
    text = text.replace("[depth]\n", f"{section}[depth]\n")
    return text[: text.index("stages = ")] + 'stages = ["difference", "picture_features", "feature_wrench"]\n'


def picture(rng: np.random.Generator, pressed: float) -> npt.NDArray[np.uint8]:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    light = 90 + 0.3 * x + 0.2 * y
    bump = pressed * np.exp(-((x - 55) ** 2 + (y - 40) ** 2) / 300)
    colours = light[..., None] * [0.9, 1.0, 1.1] + bump[..., None] * [1.0, -0.7, 0.2]
    return np.clip(colours + rng.normal(0, 1, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shape", CORNERS)
def test_features_and_wrench_are_those_of_the_mirror(shape: str) -> None:
    rng = np.random.default_rng(7)
    text = board_text(CORNERS[shape])
    board, parsed = read_board(text), parse_board(text.encode(), "small")
    cell = cells(board)
    kind = tables(rng, 60)
    file = pack(kind, {**base_metadata(parsed), "wrench.features": "picture"})
    wrench, saturations, seen = FeatureWrench(kind), Saturations(), []
    with Pipeline(parsed, file.data) as core:
        at_rest = np.stack([picture(rng, 0.0) for _ in range(N_REST)])
        for frame in at_rest:
            core.process(frame)
        rest = rest_image(at_rest)
        for t, pressed in enumerate([0.0, 5.0, 40.0, 80.0, -60.0, 0.0]):
            frame = picture(rng, pressed)
            said = core.process(frame, capture_s=0.03 * t)
            change = relative_change(frame, 8 * rest, reciprocal(rest))
            expected = features(change, cell, 20)
            assert core.features().tolist() == expected.tolist(), t
            stated = wrench.run(expected.tolist(), round(30_000 * t) + (t == 0), saturations)
            assert said.wrench_un.tolist() == stated.wrench, t
            assert core.covariance().tolist() == stated.covariance
            seen.append(np.abs(expected).max())
    assert max(seen) > 20 * min(seen)


def test_every_pixel_of_the_whole_picture_but_its_last_row_and_column_is_in_a_cell() -> None:
    cell = cells(read_board(board_text(CORNERS["whole"], 11, 9)))
    y, x = np.mgrid[:90, :121]
    assert (cell[:90, :121] == y * 9 // 90 * 11 + x * 11 // 121).all()
    assert (cell[90] == -1).all() and (cell[:, 121] == -1).all()


def test_perspective_is_that_of_the_corners() -> None:
    """Against the projective map that OpenCV fits to the corners, away from the borders of cells."""
    cv2 = pytest.importorskip("cv2")
    corners = CORNERS["perspective"]
    to_gel = cv2.getPerspectiveTransform(np.float32(corners), np.float32([[0, 0], [5, 0], [5, 4], [0, 4]]))
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    u, v = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2), to_gel)[0].T.reshape(2, HEIGHT, WIDTH)
    is_clear = (np.abs(u - np.round(u)) > 1e-3) & (np.abs(v - np.round(v)) > 1e-3)
    is_on = (u > 0) & (u < 5) & (v > 0) & (v < 4)
    expected = np.where(is_on, np.floor(v) * 5 + np.floor(u), -1)
    assert (cells(read_board(board_text(corners))) == expected)[is_clear].all()
    assert is_clear.mean() > 0.95


@pytest.mark.parametrize(
    ("corners", "sentence"),
    [
        ([[10, 5], [110, 5], [110, 85]], "must list four corners"),
        ([[10, 5], [10, 85], [110, 85], [110, 5]], "top left, top right, bottom right, bottom left"),
        ([[10, 5], [110, 5], [12, 6], [10, 85]], "must go round a convex gel"),
        ([[10, 5], [122, 5], [110, 85], [10, 85]], "reaches beyond the picture"),
    ],
)
def test_corners_that_are_no_gel_are_refused(corners: list[list[int]], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        parse_board(board_text(corners).encode(), "small")


def test_markers_and_pictures_are_not_mixed() -> None:
    text = board_text(CORNERS["upright"]).replace('"picture_features", "feature', '"markers", "picture_features", "feature')
    with pytest.raises(InputError, match="stages markers and picture_features both write the slot features"):
        parse_board(text.encode(), "small")
