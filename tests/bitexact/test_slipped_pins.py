"""Slipped rows of scattered markers against the mirror, on drawn pins, presses, slips and lost pins."""

from __future__ import annotations

import ctypes

import numpy as np
import numpy.typing as npt

from ruffini.core import native_folder

Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

HEIGHT, WIDTH, N_VIEWS = 240, 320, 2
NONE, LIMIT, STEP, MIN_PAIRS = -1, 13_107, 4 << 16, 16


def neighbours(rest: Ints, absent: Flags) -> tuple[Ints, Ints]:
    """firmware/image/slipped_pins.h, learn(); `rest` (n, 2) px Q16, view by view."""
    n, reach = len(rest), (HEIGHT << 16) // 8
    view = np.arange(n) // (n // N_VIEWS)
    dx, dy = (rest[:, axis] - rest[:, axis, None] for axis in (0, 1))  # [i, j]: from i to j
    square = dx**2 + dy**2
    may = ~absent & ~absent[:, None] & (view == view[:, None]) & (np.abs(dx) <= np.abs(dy))
    may &= (np.abs(dy) <= reach) & (square <= reach**2)
    found = [np.where(may & side, square, np.iinfo(np.int64).max) for side in (dy < 0, dy > 0)]
    above, below = (np.where(one.min(axis=1) <= reach**2, one.argmin(axis=1), NONE) for one in found)
    return above, below


def has_slipped(rest: Ints, moved: Ints, lost: Flags, absent: Flags) -> bool:
    """firmware/image/slipped_pins.h, run()."""
    above, below = neighbours(rest, absent)
    known = np.append(~lost & ~absent, False)  # NONE is not
    y = rest[:, 1] + moved[:, 1]
    count = np.zeros((HEIGHT // 4, 5), int)  # pairs; to either side along x, y
    for i, j in enumerate(below):
        if not (known[i] and known[j]):
            continue
        beside = [moved[b] - moved[a] for a, b in ((above[i], i), (j, below[j])) if known[a] and known[b]]
        if not beside:
            continue
        bend = len(beside) * (moved[j] - moved[i]) - sum(beside)
        first, last = max(-(-int(y[i]) // STEP), 0), min(int(y[j]) // STEP, len(count) - 1)
        sides = [axis > len(beside) * LIMIT for axis in (*bend, *-bend)]
        count[first : last + 1] += np.array([1, *sides])
    return bool(((count[:, 0] >= MIN_PAIRS) & (2 * count[:, 1:].max(axis=1) >= count[:, 0])).any())


def test_slipped_pins_are_the_mirrors() -> None:
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_slipped_pins
    rng, told = np.random.default_rng(3), {False: [0, 0], True: [0, 0]}
    for turn in range(120):
        n = 2 * int(rng.integers(240, 300))
        angle, radius = rng.uniform(0, 2 * np.pi, n), 100 * np.sqrt(rng.uniform(0, 1, n))
        away = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        place = away + np.array([160, 120]) + np.repeat([[0, 0], [WIDTH, 0]], n // 2, axis=0)
        press = away - rng.uniform(-50, 50, 2)
        moved = rng.uniform(0, 1) * press / 50 * np.exp(-(press**2).sum(axis=1, keepdims=True) / 2 / 50**2)
        is_slipped = bool(turn % 2)
        if is_slipped:
            start, part = rng.uniform(60, 120), rng.uniform(20, 60)
            in_rows = (place[:, 1] > start) & (place[:, 1] < start + part)
            moved[in_rows] += rng.choice([-2, -1, 1, 2, 6]) * np.array([1, 0] if rng.random() < 0.7 else [0, 1])
        rest, way = (np.round(65536 * p).astype(np.int64) for p in (place, moved + rng.normal(0, 0.03, (n, 2))))
        absent, lost = rng.random(n) < rng.choice([0, 0.1]), rng.random(n) < rng.choice([0.0, 0.02, 0.2])
        before, now = np.zeros((n, 6), np.int32), np.zeros((n, 6), np.int32)
        before[:, 0:2] = now[:, 0:2] = rest
        before[:, 5], now[:, 2:4], now[:, 4] = absent, way, lost
        now[:, 5] = absent
        found = door(n, N_VIEWS, HEIGHT, *(a.ctypes.data_as(ctypes.c_void_p) for a in (before, now)))
        assert bool(found) == has_slipped(rest, way, lost, absent), turn
        told[is_slipped][found] += 1
    assert told[False][1] == 0, told
    assert told[True][1] > 0.9 * sum(told[True]), told
