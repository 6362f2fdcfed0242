"""Wrench of features: linear, quadratic, temperature, relaxation, agreement, covariance.

Python integers: nothing can overflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
import numpy.typing as npt

from mirror.fixed import Saturations
from mirror.relaxation import relaxed_part

Tensors = dict[str, npt.NDArray[np.generic]]
MAX_FORCE = 1 << 36


def _round_shift(x: int, shift: int) -> int:
    return (x + (1 << (shift - 1))) >> shift


@dataclass(frozen=True)
class Said:
    """Wrench (uN, uN um), covariance (upper triangle), whether features agree, are in range, temperature is known."""

    wrench: list[int]
    covariance: list[int]
    agrees: bool
    is_in_range: bool
    is_warmth_known: bool


class FeatureWrench:
    """The tables of kind `wrench`, and what was loaded before."""

    def __init__(self, tensors: Tensors) -> None:
        self._table = {name: np.asarray(tensors[name]).astype(object) for name in tensors if name.startswith("wrench.")}
        self._full = [int(v) << 4 for v in self._table["wrench.full_scale"]]
        self._square_shift = self._table.get("wrench.square_shift", [0] * 6)
        n_terms = len(self._table.get("wrench.relax_time_ms", []))
        self._state = [[0] * 6 for _ in range(n_terms)]
        self._before, self._last_us = [0] * 6, 0

    def _scaled(self, y: list[int]) -> list[int]:
        return [
            min(max(((v << 14) + full // 2) // full, -(2 << 14)), 2 << 14) if full else 0
            for v, full in zip(y, self._full, strict=True)
        ]

    @staticmethod
    def _products(u: list[int]) -> list[int]:
        return [_round_shift(u[j] * u[k], 14) for j in range(6) for k in range(j, 6)]

    def _kernel(self, features: list[int], e: list[int]) -> tuple[list[int], int]:
        """`e` with what stages/feature_wrench/kernel_map.h adds, and how far outside of what was fitted, Q8."""
        table = {name.removeprefix("wrench.kernel_"): v for name, v in self._table.items() if "kernel" in name}
        if not table:
            return e, 0
        limit = 1 << 26
        z = [
            min(max(_round_shift(sum(int(p) * f for p, f in zip(row, features, strict=True)), int(table["shift"][0])),
                    -limit), limit)
            for row in table["project"]
        ]  # fmt: skip
        distances = [isqrt(sum((a - int(c)) ** 2 for a, c in zip(z, row, strict=True))) for row in table["landmark"]]
        curve = [int(v) for v in table["curve"]]
        values = []
        for distance in distances:
            held = min(distance, 1024 << 14)
            i = min(held >> 14, 1023)
            part = held - (i << 14)
            values.append(_round_shift(curve[i] * ((1 << 14) - part) + curve[i + 1] * part, 14))
        out = [
            v + (int(offset) << 4) + _round_shift(sum(int(w) * k for w, k in zip(row, values, strict=True)), int(shift))
            for v, offset, row, shift in zip(e, table["offset"], table["weight"], table["shift"][1:], strict=True)
        ]
        excess = max(min(distances) - int(table["reach"][0]), 0)
        return out, 1 + (excess * int(table["reach"][1]) >> 20) if excess else 0

    def run(
        self,
        features: list[int],
        capture_us: int,
        saturations: Saturations,
        warm: tuple[int | None, int | None] = (None, None),
    ) -> Said:
        """`warm`: thousandths of a degree now, and when rest was learned."""
        table = self._table
        y = []
        held = [min(max(f, -(1 << 26)), 1 << 26) for f in features]
        for row, shift in zip(table["wrench.gain"], table["wrench.shift"], strict=True):
            exact = _round_shift(sum(int(k) * f for k, f in zip(row, held, strict=True)), int(shift))
            y.append(min(max(exact, -MAX_FORCE), MAX_FORCE))
            saturations.count += y[-1] != exact
        u = self._scaled(y)
        pairs = self._products(u)
        e = [
            v + _round_shift(sum(int(q) * p for q, p in zip(row, pairs, strict=True)), 14 - int(coarse))
            for v, row, coarse in zip(y, table["wrench.square"], self._square_shift, strict=True)
        ]
        e, outside = self._kernel(held, e)
        e = [min(max(v, -MAX_FORCE), MAX_FORCE) for v in e]
        strained = self._scaled(e)
        agrees = self._agrees(features, [*strained, *self._products(strained)])
        is_warmth_known, e = self._corrected(e, *warm)
        if agrees and capture_us:
            e = self._relaxed(e, capture_us)
        covariance = self._covariance(self._scaled(e), outside)
        if self._is_untouched(held):
            e = [0] * 6
            sigma = [int(v) for v in table["wrench.rest_error"]]
            covariance = [sigma[i] ** 2 if i == j else 0 for i in range(6) for j in range(i, 6)]
        wrench = [
            0 if not full else _round_shift(v if i < 3 else 1000 * v, 4)
            for i, (v, full) in enumerate(zip(e, self._full, strict=True))
        ]
        limit = 1 << 14 if "wrench.kernel_curve" in table else 5 << 12
        is_in_range = outside == 0 and all(abs(v) <= limit for v in strained)
        return Said(wrench, covariance, agrees, is_in_range, is_warmth_known)

    def _is_untouched(self, features: list[int]) -> bool:
        if "wrench.rest_project" not in self._table:
            return False
        limit, shift = 1 << 26, int(self._table["wrench.rest_shift"][0])
        places = [
            _round_shift(sum(int(p) * f for p, f in zip(row, features, strict=True)), shift)
            for row in self._table["wrench.rest_project"]
        ]
        return sum(min(max(z, -limit), limit) ** 2 for z in places) <= 1 << 40

    def _corrected(self, e: list[int], now: int | None, at_rest: int | None) -> tuple[bool, list[int]]:
        if "wrench.warm_mc" not in self._table:
            return True, e
        reference, coldest, warmest = (int(v) for v in self._table["wrench.warm_mc"])
        if now is None or not coldest - 10_000 <= now <= warmest + 10_000:
            return False, e
        since_rest, since_reference = (
            min(max(now - then, -100_000), 100_000) for then in (reference if at_rest is None else at_rest, reference)
        )
        out = []
        for v, gain, offset in zip(e, self._table["wrench.warm_gain"], self._table["wrench.warm_offset"], strict=True):
            cold = v - _round_shift(int(offset) * since_rest, 10)
            out.append(cold + _round_shift(cold * _round_shift(int(gain) * since_reference, 10), 20))
        return True, out

    def _agrees(self, features: list[int], basis: list[int]) -> bool:
        if "wrench.forward" not in self._table:
            return True
        rows = zip(features, self._table["wrench.forward"], self._table["wrench.tolerance"], strict=True)
        return all(
            abs(f - _round_shift(sum(int(g) * b for g, b in zip(row, basis, strict=True)), 14)) <= int(tolerance)
            for f, row, tolerance in rows
        )

    def _relaxed(self, e: list[int], capture_us: int) -> list[int]:
        if not self._state:
            return e
        is_first = self._last_us == 0 or capture_us <= self._last_us
        duration = 0 if is_first else capture_us - self._last_us
        self._last_us = max(capture_us, self._last_us)
        out = list(e)
        for t, state in enumerate(self._state):
            step = relaxed_part(duration, 1000 * int(self._table["wrench.relax_time_ms"][t]))
            for i in range(6):
                mean = _round_shift(e[i] + self._before[i], 1)
                state[i] += _round_shift((mean - state[i]) * step, 20)
                out[i] -= _round_shift(state[i] * int(self._table["wrench.relax_part"][t][i]), 20)
        self._before = list(e)
        return out

    def _covariance(self, u: list[int], outside: int) -> list[int]:
        size = isqrt(sum(v * v >> 12 for v in u)) + min(outside, 4 << 8)
        constant, growing = self._table["wrench.error"]
        vectors = [[int(v) for v in row] for row in constant]
        vectors += [[_round_shift(int(v) * size, 8) for v in row] for row in growing]
        return [sum(v[i] * v[j] for v in vectors) for i in range(6) for j in range(i, 6)]
