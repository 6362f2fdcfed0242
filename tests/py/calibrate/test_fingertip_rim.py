"""How far a fit's presses move a fingertip's rim, against the mirror of what the firmware measures."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ruffini.estimators.fingertip.rim import LEAST_PX, MARGIN, MOST_PX, rim_at_most, rim_motion

sys.path.append(str(Path(__file__).parents[2] / "bitexact"))
from mirror.rim_motion import has_moved, motion, rim


def drawn(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pins of a round view (n, 2), px, and motions (t, n, 2): shifts, turns and zooms with noise."""
    angle, radius = rng.uniform(0, 2 * np.pi, n), 100 * np.sqrt(rng.uniform(0, 1, n))
    away = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    way = rng.normal(size=(50, 4)) * [1, 1, 0.01, 0.01]
    moved = way[:, None, :2] + way[:, 2, None, None] * away
    moved = moved + way[:, 3, None, None] * np.column_stack([-away[:, 1], away[:, 0]])
    return away + np.array([160, 120]), moved + rng.normal(0, 0.05, moved.shape)


def test_it_is_what_the_firmware_measures() -> None:
    rng = np.random.default_rng(1)
    for n in (40, 292):
        rest, moved = drawn(n, rng)
        rest_q16, there = np.round(65536 * rest).astype(np.int64), np.zeros(n, bool)
        sectors = rim(rest_q16, there)
        theirs = [motion(sectors, np.round(65536 * m).astype(np.int64), there) for m in moved]
        wanted = np.array([[max(m[:2]), max(m[2:])] for m in theirs]) / 65536
        np.testing.assert_allclose(rim_motion(rest, moved), wanted, atol=1e-4)


def test_presses_like_those_of_the_fit_are_no_camera_that_moved() -> None:
    rng = np.random.default_rng(2)
    load = rng.uniform(0.04, 1, 400)
    motion_px = load[:, None] * rng.uniform(0, 3, (400, 2))
    at_most = rim_at_most(motion_px, load)
    most = tuple(np.round(65536 * at_most).astype(int).tolist())
    for (shift, zoom), part in zip(np.round(65536 * motion_px).astype(int).tolist(), load.tolist(), strict=True):
        assert not has_moved((shift, 0, zoom, 0), round(1e6 * part), 1_000_000, most)
    assert (at_most < 3 * MARGIN).all()
    np.testing.assert_array_equal(rim_at_most(0.1 * motion_px, load), LEAST_PX)


def test_a_camera_that_moved_in_one_press_teaches_nothing() -> None:
    rng = np.random.default_rng(3)
    load = np.tile(np.linspace(0.04, 1, 10), 60)
    motion_px = load[:, None] * rng.uniform(0, 0.3, (600, 2))
    motion_px[:10] += 2.0  # one press of sixty
    np.testing.assert_array_equal(rim_at_most(motion_px, load), LEAST_PX)
    motion_px[:] = 50.0
    assert (rim_at_most(motion_px, load) == MOST_PX).all()
