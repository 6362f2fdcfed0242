"""Whether the forces of a frame are all that presses: firmware/solve/spread_check.h."""

from __future__ import annotations

import numpy as np

from mirror.fixed import I64


def is_explained(places: list[tuple[int, int]], u: I64, force: I64, spread: I64, limit: int, is_pressed: bool) -> bool:
    """Of displacement and force (n_nodes, 3) the sums about the pad's centre, in Python's integers."""
    moved = [int(p) * int(v) for place, node in zip(places, u.reshape(-1, 3), strict=True)
             for p, v in zip(place, node, strict=False)]  # fmt: skip
    held = np.clip(force.ravel(), -(1 << 27), 1 << 27)
    explained = sum(int(q) * int(f) for q, f in zip(spread, held, strict=True))
    allowed = (3 if is_pressed else 1) * limit + (32 * sum(abs(v) for v in moved) >> 8)
    return abs(sum(moved) - explained) <= allowed


def is_rim_pressed(force: I64, shape: tuple[int, int], threshold_lsb: int) -> bool:
    """More than an eighth of the outermost nodes press harder than a quarter of the threshold."""
    pressed = force.reshape(*shape, 3)[..., 2] < -(threshold_lsb // 4)
    is_rim = np.ones(shape, bool)
    is_rim[1:-1, 1:-1] = False
    return bool(8 * np.count_nonzero(pressed & is_rim) > np.count_nonzero(is_rim))
