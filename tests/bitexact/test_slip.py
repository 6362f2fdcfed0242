"""Stick and slip of the core against the numpy mirror, bit for bit: contacts that move, and whatever else comes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple

import numpy as np
import numpy.typing as npt
import pytest
from core_stages import CoreStages
from mirror.board import Board
from mirror.slip import INCIPIENT, SLIDES, STICKS, UNKNOWN, SlipTracker
from odd_boards import board_text, small_board

OpenStages = Callable[[str], tuple[CoreStages, Board]]
Field = tuple[npt.NDArray[np.uint8], npt.NDArray[np.int32], npt.NDArray[np.int16]]


def both(core: CoreStages, mirror: SlipTracker, field: Field) -> list[int]:
    """One frame through both; the states of its contacts."""
    mask, force, u = field
    plane, rows = core.slip(mask, force, u)
    expected_plane, expected = mirror.track(mask.astype(np.int64), force.astype(np.int64), u.astype(np.int64))
    assert np.array_equal(plane, expected_plane)
    assert rows == [list(astuple(s)) for s in expected]
    return [row[0] for row in rows]


def sheared_ball(mirror: SlipTracker, t: float, scale: float, rng: np.random.Generator) -> Field:
    """A ball under growing shear: rim first, then all of it at mu 0.5; nodes that slip lag behind."""
    x, y = mirror.x - 200.0, mirror.y + 100.0
    r = np.hypot(x, y) / 2600.0
    pressure = scale * np.sqrt(np.clip(1 - r**2, 0, None))
    stuck = np.sqrt(np.clip(1 - t, 0, 1))
    shear = 0.5 * np.where(r >= stuck, pressure, pressure * np.clip(r / max(stuck, 0.01), 0.2, 1) * min(t, 1.0))
    force = np.stack([0.8 * shear, -0.6 * shear, -pressure], axis=-1) * rng.normal(1, 0.02, (*r.shape, 1))
    go = 2400.0 * t * np.where(r < stuck, 1.0, 0.55)
    turn = 0.01 * t * np.stack([-y, x], axis=-1) * 8
    u = np.stack([0.8 * go, -0.6 * go, -3000 * np.exp(-(r**2))], axis=-1) + rng.normal(0, 20, (*r.shape, 3))
    u[..., :2] += turn
    mask = ((r < 1.3) * 128).astype(np.uint8)
    return mask, np.round(force).astype(np.int32), np.round(u).astype(np.int16)


@pytest.mark.parametrize("scale", [900.0, 3e8])
def test_a_contact_from_sticking_to_sliding_and_back(open_stages: OpenStages, scale: float) -> None:
    core, board = open_stages(board_text("gelslim"))
    mirror = SlipTracker(board)
    rng = np.random.default_rng(3)
    way = np.concatenate([np.linspace(0, 1.15, 24), np.full(6, 1.15), np.linspace(1.15, 0.2, 10)])
    states = [both(core, mirror, sheared_ball(mirror, t, scale, rng))[0] for t in way]
    assert states[0] == UNKNOWN
    assert states[2] == STICKS
    assert states.index(INCIPIENT) < states.index(SLIDES)
    assert states[29] == SLIDES
    assert states[-1] == STICKS
    core.slip_forget()
    mirror.forget()
    assert both(core, mirror, sheared_ball(mirror, 0.9, scale, rng)) == [UNKNOWN]


@pytest.mark.parametrize("seed", range(3))
def test_whatever_comes(open_stages: OpenStages, seed: int) -> None:
    """Random masks, forces to the end of 32 bits, displacements to the end of 16: the mirror's sums cannot wrap."""
    core, board = open_stages(small_board() if seed else board_text("gelslim"))
    mirror = SlipTracker(board)
    rng = np.random.default_rng(seed)
    shape, n_judged = mirror.x.shape, 0
    for frame in range(60):
        mask = (rng.random(shape) < rng.choice([0.3, 0.8, 1.0])).astype(np.uint8)
        limit = int(rng.choice([1, 50, 100_000, 2**31 - 1]))
        force = rng.integers(-limit - 1, limit + 1, (*shape, 3)).astype(np.int32)
        if frame % 3:  # most nodes press
            force[..., 2] = -np.abs(force[..., 2].astype(np.int64)).clip(limit // 2, 2**31 - 1)
        u = rng.integers(-32768, 32768, (*shape, 3)) if frame % 2 else rng.integers(-200, 200, (*shape, 3))
        states = both(core, mirror, (mask, force, u.astype(np.int16)))
        n_judged += sum(state != UNKNOWN for state in states)
    assert n_judged > 8
