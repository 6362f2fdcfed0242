"""Weights of the nearest scattered markers at one place: moving least squares of order 2 in Python integers."""

from __future__ import annotations

from math import isqrt

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64

SOFT, SLOPE, CURVATURE = 1311, 6711, 67109
COUNT, ORDER = 16, 6


def _shift(value: int, by: int) -> int:
    return (value + (1 << (by - 1))) >> by


def _basis(x: int, y: int) -> list[int]:
    return [4096, x, y, x * x >> 12, x * y >> 12, y * y >> 12]


def _first_column(g: list[list[int]]) -> list[int]:
    """Of the inverse, Q20, of a Q26 matrix."""
    right = [1 << 26] + [0] * (ORDER - 1)
    for p in range(ORDER):
        g[p][p] = max(g[p][p], SLOPE // 2)
        for i in range(p + 1, ORDER):
            factor = (g[i][p] << 26) // g[p][p]
            g[i] = [v - _shift(factor * g[p][j], 26) if j >= p else v for j, v in enumerate(g[i])]
            right[i] -= _shift(factor * right[p], 26)
    out = [0] * ORDER
    for i in reversed(range(ORDER)):
        out[i] = ((right[i] << 20) - sum(g[i][j] * out[j] for j in range(i + 1, ORDER))) // g[i][i]
    return out


def weights(place: tuple[int, int], rest: I64, is_there: npt.NDArray[np.bool_]) -> dict[int, int]:
    """Weight Q28 of each marker that counts at a place."""
    apart2 = {int(i): sum((int(rest[i, a]) - place[a]) ** 2 for a in (0, 1)) for i in np.flatnonzero(is_there)}
    order = sorted(apart2, key=lambda i: (apart2[i], i))[: COUNT + 1]
    if not order:
        return {0: 0}
    reach2 = max(apart2[order[-1]], 1)
    near, reach = order[:-1], isqrt(reach2)
    basis = [_basis(*((int(rest[i, a]) - place[a]) * 4096 // reach for a in (0, 1))) for i in near]
    t = [(apart2[i] << 16) // reach2 for i in near]
    w = [(65536 - s) ** 2 // (s + SOFT) + 1 for s in t]
    w = [(one << 26) // sum(w) for one in w]
    g = [
        [_shift(sum(one * b[i] * b[j] for one, b in zip(w, basis, strict=True)), 24) for j in range(ORDER)]
        for i in range(ORDER)
    ]
    for i in range(1, ORDER):
        g[i][i] += SLOPE if i < 3 else CURVATURE
    column = _first_column(g)
    value = [sum(b * c for b, c in zip(one, column, strict=True)) for one in basis]
    out = {i: _shift(one * (v >> 12), 18) for i, one, v in zip(near, w, value, strict=True)}
    out[order[0]] = out.get(order[0], 0) + (1 << 28) - sum(out.values())
    return out
