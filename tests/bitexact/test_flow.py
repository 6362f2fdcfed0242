"""Texture flow of the core against the numpy mirror, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from mirror.board import Board
from mirror.flow import Flow
from odd_boards import small_board

OpenStages = Callable[[str], tuple[CoreStages, Board]]
U16 = npt.NDArray[np.uint16]
U8 = npt.NDArray[np.uint8]


def textured(width: int, height: int) -> str:
    """Odd lattice over an odd image, patches up to the border."""
    text = small_board(width=width, height=height, step=1).replace('"dark"', '"texture"')
    text = text.replace('"photometric", "poisson", ', "")
    return text.replace("threshold_1e3 = 137", "threshold_1e3 = 700")


def speckle(rng: np.random.Generator, shape: tuple[int, int], soft: int) -> U16:
    """B, G, R in 1/16 levels, each with a texture of its own."""
    level = rng.integers(0, 4081, (*shape, 3)).astype(float)
    for _ in range(soft):
        level = (level + np.roll(level, 1, 0) + np.roll(level, 1, 1) + np.roll(level, (1, 1), (0, 1))) / 4
    return np.asarray(np.round(level), np.uint16)


def grey_of(levels: U16) -> U16:
    """As firmware/image/difference.h and frame_path.cpp have it."""
    sums = levels.astype(np.int64) @ [1, 2, 1]
    return np.asarray((3 * sums + 2) >> 2, np.uint16)


def seen(levels: npt.NDArray[np.floating] | U16) -> U8:
    return np.ascontiguousarray(np.clip(np.round(np.asarray(levels) / 16), 0, 255).astype(np.uint8))


@pytest.mark.parametrize(("width", "height"), [(67, 65), (64, 64), (129, 97)])
@pytest.mark.parametrize("soft", [0, 3])
def test_flow(open_stages: OpenStages, width: int, height: int, soft: int) -> None:
    core, board = open_stages(textured(width, height))
    m = board["markers"]
    n = m["n_x"] * m["n_y"]
    rng = np.random.default_rng([width, soft])
    rest = speckle(rng, (height, width), soft)
    bright = rest * 1.1 + rng.normal(0, 30, rest.shape)
    frames = [
        seen(rest),
        seen(np.roll(bright, (3, -2), (0, 1))),
        seen(np.roll(bright, (-9, 7), (0, 1))),
        seen(speckle(rng, (height, width), soft)),  # another texture: all are lost
        np.full(rest.shape, 60, np.uint8),
    ]
    learned_flow = Flow(board)
    assert learned_flow.learn(grey_of(rest), rest) == n
    assert learned_flow.colours.is_sound.any()
    lost: list[int] = []
    mean_quality: list[float] = []
    for frame in frames:
        flow = deepcopy(learned_flow)
        grey = grey_of(frame.astype(np.uint16) << 4)
        learned, tracked, quality, (n_found, n_lost) = core.flow((rest, grey_of(rest)), (frame, grey), n)
        assert n_found == n
        assert np.array_equal(learned, flow.rows)
        assert n_lost == flow.track(grey, frame)
        assert np.array_equal(tracked, flow.rows)
        assert np.array_equal(quality, flow.quality)
        mean_quality.append(quality.mean())
        lost.append(n_lost)
    assert lost[0] == 0
    assert lost[-1] == n
    assert mean_quality[0] > mean_quality[1] > mean_quality[-1] == 0


def test_patches_without_contrast_are_absent(open_stages: OpenStages) -> None:
    core, board = open_stages(textured(129, 97))
    n = board["markers"]["n_x"] * board["markers"]["n_y"]
    rng = np.random.default_rng(5)
    rest = speckle(rng, (97, 129), 2)
    rest[:, :40] = 1600
    rest[:, 90:] = np.arange(39)[:, None] * 25 + 1000  # contrast along x alone
    frame, flow = seen(rest), Flow(board)
    grey = grey_of(frame.astype(np.uint16) << 4)
    learned, tracked, quality, (n_found, _) = core.flow((rest, grey_of(rest)), (frame, grey), n)
    assert n_found == flow.learn(grey_of(rest), rest)
    assert 0 < n_found < n
    assert 0 < flow.colours.is_sound.sum() < n
    assert np.array_equal(learned, flow.rows)
    flow.track(grey, frame)
    assert np.array_equal(tracked, flow.rows)
    assert np.array_equal(quality, flow.quality)
    assert (quality > 0).sum() == n_found
