"""Whether the forces of a frame are all that presses: firmware/solve/spread_check.h."""

from __future__ import annotations

import numpy as np

from mirror.fixed import I64


def is_explained(places: list[tuple[int, int]], u: I64, force: I64, spread: I64, limit: int, is_pressed: bool) -> bool:
    """Of displacement and force (n_nodes, 3) the sums about the pad's centre, in Python's integers."""
    xy = u.reshape(-1, 3)[:, :2].tolist()
    moved = [p * v for place, node in zip(places, xy, strict=True) for p, v in zip(place, node, strict=True)]
    everything = sum(abs(v) for v in moved)
    held = np.clip(force.ravel(), -(1 << 27), 1 << 27)
    if not (is_pressed and held.any()):
        n = len(xy)
        odd = sum(abs(sum(p * (v - w) for p, v, w in zip(places[i], xy[i], xy[n - 1 - i], strict=True)))
                  for i in range(n // 2))  # fmt: skip
        return abs(sum(moved)) <= min(limit + (32 * odd >> 8), max(limit, everything) // 2)
    explained = sum(int(q) * int(f) for q, f in zip(spread, held, strict=True))
    return abs(sum(moved) - explained) <= 5 * limit // 2 + (32 * everything >> 8)


def is_rim_pressed(force: I64, shape: tuple[int, int], threshold_lsb: int) -> bool:
    """More than an eighth of the outermost nodes press harder than a quarter of the threshold."""
    pressed = force.reshape(*shape, 3)[..., 2] < -(threshold_lsb // 4)
    is_rim = np.ones(shape, bool)
    is_rim[1:-1, 1:-1] = False
    return bool(8 * np.count_nonzero(pressed & is_rim) > np.count_nonzero(is_rim))
