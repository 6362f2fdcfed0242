"""Texture flow of the core against the numpy mirror, bit for bit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from mirror.board import Board
from mirror.flow import Flow
from odd_boards import small_board

OpenStages = Callable[[str], tuple[CoreStages, Board]]
Grey = npt.NDArray[np.uint16]


def textured(width: int, height: int) -> str:
    """Odd lattice over an odd image, patches up to the border."""
    text = small_board(width=width, height=height, step=1).replace('"dark"', '"texture"').replace('"photometric", ', "")
    return text.replace("threshold_1e3 = 137", "threshold_1e3 = 700")


def speckle(rng: np.random.Generator, shape: tuple[int, int], soft: int) -> Grey:
    level = rng.integers(0, 12241, shape).astype(float)
    for _ in range(soft):
        level = (level + np.roll(level, 1, 0) + np.roll(level, 1, 1) + np.roll(level, (1, 1), (0, 1))) / 4
    return np.asarray(np.round(level), np.uint16)


@pytest.mark.parametrize(("width", "height"), [(67, 65), (64, 64), (129, 97)])
@pytest.mark.parametrize("soft", [0, 3])
def test_flow(open_stages: OpenStages, width: int, height: int, soft: int) -> None:
    core, board = open_stages(textured(width, height))
    m = board["markers"]
    n = m["n_x"] * m["n_y"]
    rng = np.random.default_rng([width, soft])
    rest = speckle(rng, (height, width), soft)
    bright = np.clip(rest * 1.1 + rng.normal(0, 100, rest.shape), 0, 12240)
    frames = [
        rest,
        np.asarray(np.roll(bright, (3, -2), (0, 1)), np.uint16),
        np.asarray(np.roll(bright, (-9, 7), (0, 1)), np.uint16),
        speckle(rng, (height, width), soft),  # another texture: all are lost
        np.full_like(rest, 3000),
    ]
    lost: list[int] = []
    mean_quality: list[float] = []
    for frame in frames:
        flow = Flow(board)
        learned, tracked, quality, (n_found, n_lost) = core.flow(rest, np.ascontiguousarray(frame), n)
        assert n_found == flow.learn(rest) == n
        assert np.array_equal(learned, flow.rows)
        assert n_lost == flow.track(frame)
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
    rest[:, :40] = 5000
    rest[:, 90:] = np.arange(39) * 100 + 3000  # contrast along x alone
    flow = Flow(board)
    learned, tracked, quality, (n_found, _) = core.flow(rest, rest, n)
    assert n_found == flow.learn(rest)
    assert 0 < n_found < n
    assert np.array_equal(learned, flow.rows)
    flow.track(rest)
    assert np.array_equal(tracked, flow.rows)
    assert np.array_equal(quality, flow.quality)
    assert (quality > 0).sum() == n_found
