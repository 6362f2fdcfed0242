"""Printed dots by all their ink: one step of least squares against the picture at rest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.fixed import I64, round_shift
from mirror.markers import ABSENT, DX, DY, LOST, X, Y

MAX_RADIUS, UNKNOWN, LEAST_ERROR2, CENTRE_ERROR2 = 12, 1 << 20, 7, 41
MIN_CONTRAST, MAX_STEP, H_LIMIT = 576, 1 << 16, 2047


def _luma(bgr: npt.NDArray[np.integer], shift: int) -> I64:
    return round_shift(bgr.astype(np.int64) @ np.array([117, 601, 306]), shift)


def _free_of(base: I64, values: I64) -> I64:
    share_q16 = int(values @ base) * 65536 // max(int(base @ base), 1)
    return values - round_shift(base * share_q16, 16)


class DotTemplates:
    """Templates of one rest image; `rows` are mirror.markers'."""

    def __init__(self, board: Board, rest: I64, rows: I64) -> None:
        camera = board["camera"]
        radius_q16 = board["markers"]["diameter_um"] * camera["focal_mpx"] * 32768 // (camera["standoff_um"] * 1000)
        self.radius = (radius_q16 + 2 * 65536) >> 16
        level = np.minimum(_luma(rest, 10), 4080)
        self.shape = level.shape
        away = range(-self.radius, self.radius + 1)
        self.pixels = np.array([(x, y) for y in away for x in away if x * x + y * y <= self.radius * (self.radius + 1)])
        self.templates: dict[int, dict[str, I64 | int]] = {}
        for i, row in enumerate(rows):
            at = [int(row[a] + 32768) >> 16 for a in (X, Y)]
            reach = self.radius + 1
            is_inside = all(reach <= v < size - reach for v, size in zip(at, self.shape[::-1], strict=True))
            if not row[ABSENT] and is_inside and self.radius <= MAX_RADIUS:
                self._learn(level, row, at, i)

    def _learn(self, level: I64, row: I64, at: list[int], number: int) -> None:
        x, y = (self.pixels + at).T
        value = level[y, x]
        gx = (level[y, x + 1] - level[y, x - 1]) >> 1
        gy = (level[y + 1, x] - level[y - 1, x]) >> 1
        away = [((v.astype(np.int64) << 16) - int(row[a])) >> 8 for v, a in ((x, X), (y, Y))]
        n = len(value)
        t = value - (2 * int(value.sum()) + n) // (2 * n)
        nuisance = [np.full(n, 256), t.copy(), *(round_shift(a * g, 8) for g in (gx, gy) for a in away)]
        for k in range(1, len(nuisance)):
            for j in range(k):
                nuisance[k] = _free_of(nuisance[j], nuisance[k])
        free = [gx, gy]
        for one in nuisance:
            free = [_free_of(one, g) for g in free]
        hx, hy = (np.clip(g, -H_LIMIT, H_LIMIT) for g in free)
        xx, xy, yx, yy = (int(h @ g) for h in (hx, hy) for g in (gx, gy))
        det = xx * yy - xy * yx
        if xx <= 0 or yy <= 0 or det <= 0 or det // (xx + yy) < MIN_CONTRAST * n:
            return
        b = max(det.bit_length() - 33, 0)
        k4 = [(v << 33) // (det >> b) for v in (yy, -xy, -yx, xx)]
        if max(abs(v) for v in k4) >= 1 << 30:
            return
        self.templates[number] = {
            "x": at[0], "y": at[1], "t": t, "hx": hx, "hy": hy, "s0": np.array([hx @ value, hy @ value]),
            "k": np.array(k4), "shift": 33 + b - 16,
        }  # fmt: skip

    def refine(self, frame: npt.NDArray[np.uint8], rows: I64) -> I64:
        """Moves the displacements of rows in place; squared errors, Q16."""
        level = _luma(frame, 6)
        error2 = np.full(len(rows), CENTRE_ERROR2, np.int64)
        for number, one in self.templates.items():
            if not rows[number, LOST]:
                error2[number] = self._refine(level, one, rows[number])
        return error2

    def _refine(self, level: I64, one: dict[str, I64 | int], row: I64) -> int:
        place = [((int(one[a]) - self.radius) << 16) + int(row[d]) for a, d in (("x", DX), ("y", DY))]
        side = 2 * self.radius + 2
        if any(p < 0 or (p >> 16) + side > size for p, size in zip(place, self.shape[::-1], strict=True)):
            return CENTRE_ERROR2
        x, y = (p >> 16 for p in place)
        fx, fy = ((p & 0xFFFF) >> 1 for p in place)
        u, v = x + self.pixels[:, 0] + self.radius, y + self.pixels[:, 1] + self.radius

        def between(a: I64, b: I64, share_q15: int) -> I64:
            return a + round_shift((b - a) * share_q15, 15)

        upper, lower = (between(level[w, u], level[w, u + 1], fx) for w in (v, v + 1))
        seen = between(upper, lower, fy)
        t, k, shift, n = np.asarray(one["t"]), np.asarray(one["k"]), int(one["shift"]), len(seen)
        ds = np.array([one["hx"] @ seen, one["hy"] @ seen]) - one["s0"]
        step = [int(np.clip(round_shift(k[i : i + 2] @ ds, shift), -MAX_STEP, MAX_STEP)) for i in (0, 2)]
        spread = (int(seen @ seen) - int(seen.sum()) ** 2 // n) >> 10
        common = (int(t @ seen) - int(seen.sum()) * int(t.sum()) // n) >> 10
        tt = int(t @ t) >> 10
        if common <= 0 or tt <= 0 or 4 * common**2 < tt * spread:
            return UNKNOWN
        unexplained = max(spread - common**2 // tt, 0)
        gain = max(int(k[0]) + int(k[3]), 0)
        row[DX] -= 3 * step[0] >> 2
        row[DY] -= 3 * step[1] >> 2
        return LEAST_ERROR2 + (((gain * unexplained >> (shift - 16)) // n) >> 6) + (sum(s * s for s in step) >> 18)
