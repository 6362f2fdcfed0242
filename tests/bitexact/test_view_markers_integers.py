"""Pins of two views in one frame, against the mirror: each is followed for itself, a blind one spares the other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from mirror.board import Board
from mirror.markers import ABSENT, DX, DY, LOST
from mirror.view_markers import ViewMarkers
from odd_boards import small_board
from test_stages import grey

OpenStages = Callable[[str], tuple[CoreStages, Board]]
Picture = npt.NDArray[np.uint8]
WIDTH, HEIGHT, N_DOTS, N_ROOM = 99, 88, 19, 22  # of one view; there is room for more markers than dots
FRAMES = ("still", "moved", "left blind", "right blind", "hidden", "noise")


def two_views(polarity: str) -> str:
    text = small_board(width=2 * WIDTH, height=HEIGHT, polarity=polarity)
    text = text.replace(f'polarity = "{polarity}"', f'polarity = "{polarity}"\nlayout = "views"')
    text = text.replace("n_x = 5\nn_y = 3", f"n_x = {N_ROOM}\nn_y = 2")
    return text[: text.index("stages = ")] + 'stages = ["difference", "markers"]\n'


def places(rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Dots of one view, px, apart as the board's pitch has it."""
    found: list[npt.NDArray[np.float64]] = []
    while len(found) < N_DOTS:
        at = rng.uniform([8, 8], [WIDTH - 8, HEIGHT - 8])
        if all(np.hypot(*(at - other)) > 10 for other in found):
            found.append(at)
    return np.array(found)


def drawn(dots: npt.NDArray[np.float64], polarity: str, rng: np.random.Generator) -> Picture:
    y, x = np.mgrid[:HEIGHT, : 2 * WIDTH]
    away = np.sqrt(((np.stack([x, y], axis=-1)[:, :, None] - dots) ** 2).sum(axis=-1)).min(axis=2)
    ink = np.clip(3.0 - away, 0, 1)
    level = 120 + (-70 if polarity == "dark" else 110) * ink + 0.1 * x
    noisy = level[..., None] + rng.normal(0, 1, (HEIGHT, 2 * WIDTH, 3))
    return np.asarray(np.clip(np.round(noisy), 0, 255), np.uint8)


@pytest.mark.parametrize("polarity", ["dark", "light"])
@pytest.mark.parametrize("name", FRAMES)
def test_two_views_are_followed_each_for_itself(open_stages: OpenStages, name: str, polarity: str) -> None:
    core, board = open_stages(two_views(polarity))
    rng = np.random.default_rng(31)
    at = [places(rng), places(rng) + np.array([WIDTH, 0])]
    still = drawn(np.concatenate(at), polarity, rng)
    frame = still
    if name in ("moved", "left blind", "right blind"):
        shift = [at[0] + [2.3, -1.2], at[1] + [-1.6, 0.7]]
        frame = drawn(np.concatenate(shift), polarity, rng)
        if name != "moved":
            blind = slice(0, WIDTH) if name == "left blind" else slice(WIDTH, None)
            frame[:, blind] = 120  # a cap of the ground's own grey
    elif name == "hidden":
        frame = drawn(np.concatenate([at[0][4:], at[1][:-2]]) + np.array([0.4, 0.9]), polarity, rng)
    elif name == "noise":
        frame = rng.integers(0, 256, still.shape).astype(np.uint8)

    grey_still, rest = grey(still), still.astype(np.uint16) * 16
    own = ViewMarkers(board, grey_still, rest.astype(np.int64))
    n_lost = own.track(grey(frame), frame)
    rows, quality, lost = core.printed(
        (grey_still.astype(np.uint16), rest), (grey(frame).astype(np.uint16), frame), 2 * N_ROOM
    )
    assert np.array_equal(rows, own.rows)
    assert np.array_equal(quality, own.quality)
    assert lost == n_lost

    found = own.rows[:, ABSENT] == 0
    assert own.n_found == found.sum() >= 2 * N_DOTS - 4
    is_lost = (own.rows[:, LOST] != 0)[found]
    left = np.flatnonzero(found) < N_ROOM
    if name == "moved":
        assert not is_lost.any()
        for eye, wanted in ((left, (2.3, -1.2)), (~left, (-1.6, 0.7))):
            np.testing.assert_allclose(own.rows[found][eye][:, [DX, DY]] / 65536, [wanted] * eye.sum(), atol=0.2)
    if name in ("left blind", "right blind"):
        blind = left if name == "left blind" else ~left
        assert is_lost[blind].all()
        assert not is_lost[~blind].any()
    if name == "hidden":
        assert 0 < is_lost.sum() < 12
