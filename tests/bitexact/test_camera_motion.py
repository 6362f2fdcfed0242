"""Whether the camera has moved against the mirror, on drawn residuals near the limits."""

from __future__ import annotations

import ctypes

import numpy as np
from mirror.camera_motion import is_moved

from ruffini.core import native_folder


def test_the_verdict_is_the_mirrors() -> None:
    door, rng = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_camera_moved, np.random.default_rng(5)
    said = []
    for turn in range(4_000):
        n_x, n_y = (int(n) for n in rng.integers(7, 34, 2))
        force = np.round(rng.normal(size=3) * rng.choice([0.0, 0.3, 3.0, 2000.0]) * 1e6).astype(np.int64)
        noise = float(rng.choice([10, 60, 300]))
        residual = np.round(rng.normal(size=(n_y, n_x, 3)) * noise)
        y, x = np.mgrid[-1 : 1 : n_y * 1j, -1 : 1 : n_x * 1j]
        way = rng.normal(size=4) * rng.choice([0, 1, 4, 30], 4) * 64
        residual[..., 0] += way[0] + way[2] * x - way[3] * y
        residual[..., 1] += way[1] + way[2] * y + way[3] * x
        mask = (rng.random((n_y, n_x)) < rng.choice([0.0, 0.3, 0.6])).astype(np.uint8) * np.uint8(128)
        raw = residual.astype(np.int32)
        found = door(n_x, n_y, raw.ctypes.data_as(ctypes.c_void_p), mask.ctypes.data_as(ctypes.c_void_p),
                     force.ctypes.data_as(ctypes.c_void_p))  # fmt: skip
        expected = is_moved(raw.astype(np.int64), mask.astype(np.int64), force)
        assert bool(found) == expected, turn
        said.append(expected)
    assert 400 < sum(said) < 3_600, sum(said)
