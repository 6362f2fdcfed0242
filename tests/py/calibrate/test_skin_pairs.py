"""Two places against one for what a glowing skin's openings show."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ruffini.estimators.skin.pairs import excess, patch_about
from ruffini.estimators.skin.reach import REACH_SIZE, REACH_STEP_MM, reach_at
from ruffini.estimators.skin.response import Layout

Array = npt.NDArray[np.float64]

N, PITCH_MM = 9, 10.0
DX, DY = np.meshgrid(*(np.arange(n) * REACH_STEP_MM for n in REACH_SIZE))
REACH = np.exp(-((DX / 9) ** 2) - DY / 20)  # round, and along a stiff axis


def lattice() -> Layout:
    row, column = np.divmod(np.arange(N * N), N)
    places = np.column_stack([column, row]) * PITCH_MM - (N - 1) / 2 * PITCH_MM
    near = np.full((N * N, 8), -1)
    for k, (dx, dy) in enumerate([(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)]):
        x, y = column + dx, row + dy
        inside = (x >= 0) & (x < N) & (y >= 0) & (y < N)
        near[inside, k] = (y * N + x)[inside]
    return Layout(places, near, np.zeros((N * N, 2), dtype=np.intp), np.ones((N * N, 2)), 0.0)


def sink(layout: Layout, *touches: tuple[float, float, float], reach: Array = REACH) -> Array:
    """Of touches (x mm, y mm, strength), with an opening's noise."""
    total = sum(s * reach_at(reach, layout.places_mm - np.array([x, y])) for x, y, s in touches)
    return np.asarray(total + np.random.default_rng(3).normal(0, 0.01, N * N))


def of(u: Array) -> float:
    layout = lattice()
    return excess(u, patch_about(int(u.argmax()), layout, REACH))


@pytest.mark.parametrize("apart", [(13.5, 0.0), (0.0, 15.0), (10.0, 11.0)])
def test_two_fingers_are_far_beyond_what_one_leaves(apart: tuple[float, float]) -> None:
    """One whose skin is a sixth stiffer than the table says is the hardest single touch here."""
    layout = lattice()
    x, y = 2.0 + apart[0] / 2, -1.0 + apart[1] / 2
    two = of(sink(layout, (2.0 - apart[0] / 2, -1.0 - apart[1] / 2, 0.8), (x, y, 0.7)))
    stiffer = np.exp(-((DX / 10.5) ** 2) - DY / 23)
    singles = [of(sink(layout, (px, py, 0.9), reach=stiffer)) for px, py in ((0.0, 0.0), (5.0, 3.0), (3.0, 5.0))]
    assert two > 3 * max(singles), (two, singles)


def test_a_finger_at_a_rim_has_no_partner_beside_the_skin() -> None:
    """More sink on the last row than the table says: a second finger could stand only where the skin ends."""
    layout = lattice()
    u = sink(layout, (0.0, 38.0, 0.8))
    u[-N:] *= 1.3
    assert of(u) < 1.0


def test_fingers_nearer_than_an_opening_and_unlike_ones_are_one() -> None:
    layout = lattice()
    near = of(sink(layout, (-2.0, 0.0, 0.8), (2.0, 0.0, 0.8)))
    unlike = of(sink(layout, (-7.0, 0.0, 1.0), (7.0, 0.0, 0.15)))
    assert max(near, unlike) < 0.5
