"""Motion of the camera by the pad's corners against the mirror, on drawn motions, presses and lost markers."""

from __future__ import annotations

import ctypes

import numpy as np
from mirror.corner_motion import has_moved, motion

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.core import native_folder


def test_motion_and_verdict_are_the_mirrors() -> None:
    door = ctypes.CDLL(str(native_folder() / "libruffini_stages.so")).stages_corner_motion
    rng = np.random.default_rng(8)
    metadata = container.base_metadata(find_board("contact-glitter")) | {"wrench.features": "markers"}
    said, zooms = [], []
    for turn in range(500):
        n_x, n_y = (int(n) for n in rng.integers(16, 26, 2))
        y, x = np.mgrid[:n_y, :n_x].astype(float)
        places = np.stack([10 + 8 * x, 14 + 9 * y], axis=-1)
        rest = np.round(65536 * (places + rng.normal(0, 0.3, places.shape))).astype(np.int64)
        gain = rng.integers(-20, 21, (6, n_y, n_x, 2))
        gain[2] -= np.round(rng.choice([40.0, 4000.0, 40_000.0]) * (places - places.mean(axis=(0, 1)))).astype(np.int64)
        tables = {
            "wrench.gain": gain.reshape(6, -1).astype(np.int32), "wrench.shift": np.full(6, 12, np.uint8),
            "wrench.full_scale": np.where(rng.random(6) < 0.8, 10**9, 0).astype(np.int32),
            "wrench.square": np.zeros((6, 21), np.int32), "wrench.error": np.zeros((2, 6, 6), np.int32),
        }  # fmt: skip
        file = container.pack(tables, metadata | {"kinds": "wrench"}).data
        way = rng.normal(size=4) * rng.choice([0, 1], 4) * np.array([1, 1, 0.02, 0.02]) * rng.choice([0.1, 0.5, 1])
        dx, dy = np.moveaxis(places - places.mean(axis=(0, 1)), -1, 0)
        moved = np.stack([way[0] + way[2] * dx - way[3] * dy, way[1] + way[2] * dy + way[3] * dx], axis=-1)
        moved += rng.choice([0.0, 0.05]) * rng.normal(size=moved.shape)
        from_there = places - rng.uniform(places.min(), places.max(), 2)  # a press
        moved += rng.choice([0.0, 2.0]) * from_there / 20 * np.exp(-(from_there**2).sum(axis=-1, keepdims=True) / 800)
        raw = np.round(65536 * moved).astype(np.int64)
        lost = rng.random((n_y, n_x)) < rng.choice([0.0, 0.0, 0.1, 0.4])
        force = np.round(rng.normal(size=3) * rng.choice([0.0, 1.0, 1e3]) * 1e6).astype(np.int64)
        rows = np.zeros((n_y, n_x, 6), np.int32)
        rows[..., 0:2], rows[..., 2:4], rows[..., 4] = rest, raw, lost
        out = np.zeros(4, np.int64)
        found = door(file, len(file), n_x, n_y, *(a.ctypes.data_as(ctypes.c_void_p) for a in (rows, force, out)))
        assert tuple(out) == motion(rest, raw, lost), turn
        tensors = tables["wrench.gain"].astype(np.int64), tables["wrench.shift"], tables["wrench.full_scale"]
        expected = has_moved(rest, raw, lost, force, *tensors)
        assert found == int(expected), turn
        said.append(expected)
        zooms.append(out[3])
    assert 50 < sum(said) < 350, sum(said)
    assert np.count_nonzero(zooms) > 100
