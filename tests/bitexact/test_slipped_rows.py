"""Slipped rows of markers against the mirror, on drawn displacements near the limit."""

from __future__ import annotations

import ctypes

import numpy as np
import numpy.typing as npt

from ruffini.core import native_folder

Ints = npt.NDArray[np.int64]


Flags = npt.NDArray[np.bool_]


def has_slipped_rows(moved: Ints, known: Flags, absent: Flags, height: int, *, are_patches: bool) -> bool:
    """firmware/image/slipped_rows.h; `moved` (n_y, n_x, 2) px Q16, `height` between the first and the last row."""
    n_y, n_x = known.shape
    s = 2 if are_patches else 1
    if n_y < 4 * s or n_x < 2:
        return False
    limit = 13107 if are_patches else max(26214, height // (n_y - 1) // 32)
    there, lost = (~absent).sum(axis=1), (~absent & ~known).sum(axis=1)
    if are_patches and ((2 * there >= n_x) & (10 * lost >= 9 * there)).any():
        return True
    jump, both = moved[s:] - moved[:-s], known[s:] & known[:-s]
    for j in range(n_y - s):
        beside = [k for k in (j - s, j + s) if 0 <= k < n_y - s]
        n = sum(both[k].astype(np.int64) for k in beside)
        other = sum(jump[k] * both[k][:, None] for k in beside)
        counts = both[j] & (n > 0)
        if 2 * counts.sum() < n_x:
            continue
        bend = (n[:, None] * jump[j] - other)[counts]
        for sign in (1, -1):
            if (10 * (sign * bend > (n[counts] * limit)[:, None]).sum(axis=0) >= 9 * counts.sum()).any():
                return True
    return False


def test_the_verdict_is_the_mirrors() -> None:
    door, rng = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_slipped_rows, np.random.default_rng(6)
    said: list[tuple[bool, bool]] = []
    for turn in range(4_000):
        n_x, n_y, are_patches = int(rng.integers(2, 20)), int(rng.integers(3, 16)), bool(turn % 2)
        pitch = int(rng.integers(6, 40)) << 16
        moved = np.cumsum(rng.normal(0, 0.05, (n_y, n_x, 2)), axis=0) * rng.choice([0, 1, 4])
        first = int(rng.integers(n_y))
        way = rng.normal(size=2) * rng.choice([0.0, 0.4, 2.0])
        moved[first : first + int(rng.integers(1, n_y + 1))] += way
        raw = np.round(65536 * moved).astype(np.int64)
        lost = rng.random((n_y, n_x)) < rng.choice([0.0, 0.05, 0.3])
        absent = rng.random((n_y, n_x)) < 0.02
        if rng.random() < 0.1:
            lost[int(rng.integers(n_y))] = rng.random(n_x) < 0.9
        rows = np.zeros((n_y, n_x, 6), np.int32)
        rows[..., 1] = np.arange(n_y)[:, None] * pitch
        rows[..., 2:4], rows[..., 4], rows[..., 5] = raw, lost, absent
        expected = has_slipped_rows(raw, ~lost & ~absent, absent, (n_y - 1) * pitch, are_patches=are_patches)
        assert bool(door(n_x, n_y, rows.ctypes.data_as(ctypes.c_void_p), are_patches)) == expected, turn
        said.append((are_patches, expected))
    for are_patches in (False, True):
        n = sum(found for of, found in said if of == are_patches)
        assert 200 < n < 1_800, (are_patches, n)
