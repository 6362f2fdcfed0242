"""Motion of the camera by a fingertip's rim against the mirror, on drawn pins, motions, loads and lost pins."""

from __future__ import annotations

import ctypes

import numpy as np
from mirror.rim_motion import has_moved, motion, rim

from ruffini.core import native_folder


def test_motion_and_verdict_are_the_mirrors() -> None:
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_rim_motion
    rng, said = np.random.default_rng(4), []
    for turn in range(1_500):
        n = int(rng.integers(0, 300))
        angle, radius = rng.uniform(0, 2 * np.pi, n), 100 * np.sqrt(rng.uniform(0, 1, n))
        away = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        rest = np.round(65536 * (away + np.array([160, 120]))).astype(np.int64)
        way = rng.normal(size=4) * rng.choice([0, 1], 4) * np.array([1, 1, 0.01, 0.01]) * rng.choice([0.1, 0.5, 2])
        moved = way[:2] + way[2] * away + way[3] * np.column_stack([-away[:, 1], away[:, 0]])
        raw = np.round(65536 * (moved + rng.normal(0, 0.05, (n, 2)))).astype(np.int64)
        absent, lost = rng.random(n) < rng.choice([0, 0.3]), rng.random(n) < rng.choice([0.0, 0.1, 0.5])
        force, most = int(1e6 * rng.normal(0.3, 0.5)), int(rng.integers(200_000, 2_000_000))
        before, now = np.zeros((n, 6), np.int32), np.zeros((n, 6), np.int32)
        before[:, 0:2] = now[:, 0:2] = rest
        before[:, 5], now[:, 2:4], now[:, 4] = absent, raw, lost
        at_max = rng.choice([[78_643, 39_322], [0, 0], [30_000, 200_000]])
        out = np.zeros(4, np.int64)
        at, now_at, most_at, out_at = (a.ctypes.data_as(ctypes.c_void_p) for a in (before, now, at_max, out))
        found = door(n, at, now_at, ctypes.c_int64(force), ctypes.c_int64(most), most_at, out_at)
        seen = motion(rim(rest, absent), raw, lost)
        assert tuple(out) == seen, turn
        assert found == int(has_moved(seen, force, most, tuple(at_max.tolist()))), turn
        said.append(bool(found))
    assert 300 < sum(said) < 1_200, sum(said)
