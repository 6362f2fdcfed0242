"""Moments of the dent in a depth map (firmware/stages/depth_moments/depth_moments.h), in integers."""

from __future__ import annotations

import numpy as np

from mirror.board import Board, depth_grid
from mirror.fixed import I64, div_half_up

LEAST = 80  # 1/8 um
PLACE = 2048
FINE = 2048
SHARE = 1 << 24


def places(board: Board, axis: str, n: int) -> tuple[I64, I64]:
    """X of the cells along an axis, Q11 of half the pad's size, and whether each lies inside the window."""
    camera, step = board["camera"], board["depth"]["step_px"]
    middle_mpx = (2 * np.arange(n, dtype=np.int64) * step + step - 1) * 500
    um = (middle_mpx - camera[f"center_{axis}_mpx"]) * camera["standoff_um"] // camera["focal_mpx"]
    size, window = board["pad"][f"size_{axis}_um"], board["window"]
    from_corner = um + size // 2
    is_inside = (from_corner >= window[f"min_{axis}_um"]) & (from_corner <= window[f"max_{axis}_um"])
    return um * 2 * PLACE // size, is_inside


def features(board: Board, depth: I64) -> I64:
    """Of the depth (n_y, n_x), 1/8 um."""
    n_y, n_x = depth_grid(board)
    (x, is_x), (y, is_y) = places(board, "x", n_x), places(board, "y", n_y)
    e = np.maximum(-depth - LEAST, 0) * np.outer(is_y, is_x)
    n = max(int(is_x.sum() * is_y.sum()), 1)
    x, y = x[None, :], y[:, None]
    sums = np.array(
        [FINE * e.sum(), SHARE * (e > 0).sum(), FINE * e.max() * n, (e * x).sum(), (e * y).sum()]
        + [(e * p * q).sum() for p, q in ((x, x), (y, y), (x, y))]
    )
    return div_half_up(sums, n * np.array([1] * 5 + [PLACE] * 3))
