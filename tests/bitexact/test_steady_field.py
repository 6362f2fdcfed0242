"""A contact that holds still, moves and grows, averaged: the core against the mirror, and against a board that does
not average."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from mirror.board import read_board
from mirror.path import FramePath
from test_frame_path import board_with_all_stages, photometric_tables

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise

FRAMES = 6
NOISE_STEPS = np.array([4, 4, 16])  # of the operator's noise, 125 nm


def held(shape: tuple[int, int], rng: np.random.Generator) -> npt.NDArray[np.int16]:
    """Noise on a dent that is held, grows by 2 %, is held, moves, and is held beside another."""
    y, x = np.mgrid[: shape[0], : shape[1]]

    def dent(size: float, at_x: float, at_y: float) -> npt.NDArray[np.float64]:
        far2 = ((x - at_x) ** 2 + (y - at_y) ** 2) / 5
        return size * np.exp(-far2)[..., None] * np.array([0.2, -0.1, -1.0])

    center = (shape[1] * 0.35, shape[0] * 0.5)
    frames = [dent(1600, *center)] * 12 + [dent(1632, *center)] * 8
    frames += [dent(1632, center[0] + t / 3, center[1]) for t in range(6)]
    frames += [dent(1632, *center) + dent(1200, shape[1] * 0.85, shape[0] * 0.4)] * 8 + [0 * dent(1, 0, 0)] * 2
    frames += [dent(1600, *center)] * 4
    noise = rng.normal(size=(len(frames), *shape, 3)) * NOISE_STEPS
    return np.round(np.array(frames) + noise).astype(np.int16).reshape(len(frames), -1, 3)


@pytest.mark.parametrize("is_finite", [False, True])
def test_the_averaged_field_and_its_force(is_finite: bool) -> None:
    text = board_with_all_stages(2)
    asks = text.replace("min_nodes = 4\n", f"min_nodes = 4\nsteady_frames = {FRAMES}\n")
    typed, plain_board = (parse_board(t.encode(), "small") for t in (asks, text))
    noise = Noise(tuple(float(v) * 125e-9 for v in NOISE_STEPS))  # type: ignore[arg-type]
    kind = kept(make_operator, plain_board, method="support", noise=noise, is_finite=is_finite)
    file = pack(
        {**kind.tensors, **photometric_tables(np.random.default_rng(3))}, {**base_metadata(typed), **kind.metadata}
    )
    mirror = FramePath(read_board(asks), file.tensors, file.metadata)
    assert mirror.steady is not None
    averaged: list[int] = []
    with Pipeline(typed, file.data) as core, Pipeline(plain_board, file.data) as plain:
        u = held((core.layout.node_n_y, core.layout.node_n_x), np.random.default_rng(5))
        for t, one in enumerate(u):
            force, before = (p.solve(one[None])[0] for p in (core, plain))
            expected, _ = mirror.solve_given(one.astype(np.int64))
            assert np.array_equal(force, expected), t
            assert np.array_equal(force.sum(axis=0), before.sum(axis=0)), t
            averaged.append(max(mirror.steady.n))
            assert (averaged[-1] > 1) == bool((force != before).any()), t
    assert max(averaged[5:12]) == FRAMES
    assert averaged[20:26].count(1) >= 4, averaged  # the dent moves
    assert averaged[34:36] == [0, 0]
    assert averaged[36] == 1
