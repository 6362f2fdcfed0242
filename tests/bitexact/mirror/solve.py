"""Displacement -> nodal force: program and contact mask."""

from __future__ import annotations

import numpy as np

from mirror.fixed import I64, Saturations
from mirror.program import Program

FULL = 128  # a node of the contact mask that is surely touched


def linear_force(program: Program, u: I64, saturations: Saturations) -> I64:
    """(n_nodes, 3) in force steps, of (n_nodes, 3) displacements."""
    return saturations.int32(program.times(u.ravel())).reshape(-1, 3)


def _surely(pressure: I64, threshold_lsb: int) -> I64:
    return np.asarray(-(-np.clip(pressure - threshold_lsb, 0, threshold_lsb) * FULL // threshold_lsb))


Noise = tuple[int, int]  # in force steps, of 2 x 2 nodes together, and of one alone


def _threshold(side: int, force: I64, threshold_lsb: int, noise_lsb: Noise | None, is_steady: bool) -> int:
    """What counts as pressed on squares of this side."""
    unknown = max(threshold_lsb // (side * side // 4), 1)
    least = unknown if noise_lsb is None else noise_lsb[0]
    return max(least, min(threshold_lsb, int(-force[:, 2].min()) >> 3 if is_steady else threshold_lsb))


def frame_threshold(force: I64, threshold_lsb: int, noise_lsb: Noise | None, is_steady: bool = True) -> int:
    """What counts as pressed in this frame at least."""
    return _threshold(8, force, threshold_lsb, noise_lsb, is_steady)


def _opened(pressure: I64, side: int) -> I64:
    """Grey opening by squares: largest over the squares at a node of the smallest in the square."""
    out = np.zeros_like(pressure)
    n_y, n_x = pressure.shape
    for y in range(n_y - side + 1):
        for x in range(n_x - side + 1):
            at = np.s_[y : y + side, x : x + side]
            out[at] = np.maximum(out[at], pressure[at].min())
    return out


def contact_mask(
    force: I64,
    shape: tuple[int, int],
    threshold_lsb: int,
    min_nodes: int,
    noise_lsb: Noise | None = None,
    is_steady: bool = True,
) -> I64:
    """How surely each node is touched, 0..128: grey opening by squares of 2, 4 and 8 nodes, grey growth by one."""
    pressure = -force[:, 2].reshape(shape)
    pressed = np.clip(pressure, 0, (1 << 31) - 1)
    opened = np.zeros(shape, np.int64)
    for side in (2, 4, 8):
        threshold = _threshold(side, force, threshold_lsb, noise_lsb, is_steady)
        opened = np.maximum(opened, _surely(_opened(pressed, side), threshold))
    if np.count_nonzero(opened) < min_nodes:
        opened[:] = 0
    if noise_lsb is not None and is_steady:
        strongest = np.unravel_index(pressure.argmax(), shape)
        opened[strongest] = max(opened[strongest], int(_surely(pressure[strongest], noise_lsb[1])))
    padded = np.pad(opened, 1)
    grown = [padded[dy : dy + shape[0], dx : dx + shape[1]] for dy in range(3) for dx in range(3)]
    return np.asarray(np.max(grown, axis=0))
