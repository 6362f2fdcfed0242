"""Drift of lamps over the picture, as firmware/image/light_map.h and rest.h: polynomials, their fit, the map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, round_shift

NODE_PX, TERMS, WINDOW = 16, 15, 16
UNIT_GAIN = 1 << 20
MAX_SAMPLES, MIN_SAMPLES = 640, 200
GATE, EDGE, WIDE, FAR, UNLIKE, STALE = 328, 655, 983, 262, 655, (1 << 32) // 100
MAX_STEP, MAX_COEFFICIENT, SETTLED = 4096, 1 << 21, UNIT_GAIN // 2048


def limited(gain: I64) -> I64:
    return np.clip(gain, UNIT_GAIN * 3 // 4, UNIT_GAIN * 5 // 4)


def _half_up(numerator: I64, denominator: int) -> I64:
    return np.asarray((2 * numerator + denominator) // (2 * denominator))


def _legendre(u: I64) -> list[I64]:
    one = 1 << 14
    u2 = round_shift(u * u, 14)
    u4 = round_shift(u2 * u2, 14)
    third = round_shift(u * (5 * u2 - 3 * one), 15)
    return [np.full_like(u, one), u, (3 * u2 - one) >> 1, third, (35 * u4 - 30 * u2 + 3 * one) >> 3]


def _place(twice_px: I64, n: int) -> I64:
    return np.clip((twice_px - (n - 1)) * 16384 // (n - 1), -16384, 16384)


def node_lines(n: int) -> I64:
    """Places of the nodes along an axis of n pixels."""
    return np.arange((n - 1) // NODE_PX + 2, dtype=np.int64) * NODE_PX


def _products(twice_x: I64, twice_y: I64, shape: tuple[int, int]) -> I64:
    along_y = _legendre(_place(twice_y, shape[0]))
    along_x = _legendre(_place(twice_x, shape[1]))
    terms = [round_shift(along_x[order - i] * along_y[i], 16) for order in range(5) for i in range(order + 1)]
    return np.stack(terms)


def between_nodes(nodes: I64, shape: tuple[int, int]) -> I64:
    """Bilinear of (n_y, n_x) at every pixel: along y first, half up each."""
    y, x = np.arange(shape[0]), np.arange(shape[1])
    part_y, part_x = (y % NODE_PX)[:, None], x % NODE_PX
    upper, lower = nodes[y // NODE_PX], nodes[y // NODE_PX + 1]
    rows = ((NODE_PX - part_y) * upper + part_y * lower + NODE_PX // 2) >> 4
    left, right = rows[:, x // NODE_PX], rows[:, x // NODE_PX + 1]
    return np.asarray(((NODE_PX - part_x) * left + part_x * right + NODE_PX // 2) >> 4)


class LightMap:
    """The map of a picture of `shape` (h, w) by samples whose first pixels are `at` (n, 2) y, x."""

    def __init__(self, shape: tuple[int, int], at: npt.NDArray[np.int64]) -> None:
        step = -(-len(at) // MAX_SAMPLES)
        self._used = np.arange(0, len(at), step) if step else np.zeros(0, np.int64)
        self.exists = len(self._used) >= MIN_SAMPLES
        self._nodes = len(node_lines(shape[0])), len(node_lines(shape[1]))
        self.factor = np.full((3, *self._nodes), UNIT_GAIN)
        self._in_force = self.factor.copy()
        self.is_far = self.is_at_limit = self.is_stale = False
        self._coefficient = np.zeros((3, TERMS), np.int64)
        self._rate, self._extrapolated = np.zeros_like(self._coefficient), np.zeros_like(self._coefficient)
        self._gain_before = np.full(3, UNIT_GAIN)
        self._frames: list[I64] = []
        self._pads: list[int] = []
        self.n_learned = self.n_extrapolated = 0
        if self.exists:
            y, x = at[self._used].T
            node_y, node_x = np.meshgrid(node_lines(shape[0]), node_lines(shape[1]), indexing="ij")
            samples = _products(2 * x + 7, 2 * y + 1, shape)
            nodes = _products(2 * node_x.ravel(), 2 * node_y.ravel(), shape)
            self._make_basis(np.concatenate([samples, nodes], axis=1))

    @property
    def is_off(self) -> bool:
        return self.is_far or self.is_at_limit or self.is_stale

    def _make_basis(self, q: I64) -> None:
        n = len(self._used)
        self._square = np.zeros(TERMS, np.int64)
        for k in range(TERMS):
            for j in range(k):
                if self._square[j]:
                    share = _half_up(np.array((q[k, :n] * q[j, :n]).sum() * 4096), int(self._square[j]))
                    q[k] = np.clip(q[k] - round_shift(share * q[j], 12), -32768, 32767)
            square = int((q[k, :n] ** 2).sum())
            if square * 256 >= n << 24:
                self._square[k] = square
            else:
                q[k] = 0
        self._q, self._q_nodes = q[:, :n], q[:, n:]

    def run(self, sample: I64, pad: int, is_gain_followed: bool, gain: I64) -> bool:
        """One frame's (n, 3) samples; moves `gain` (3,) in place. Whether another map is to be taken.

        pad : 0 a marker is off its rest, 1 no marker is seen, 2 all are at rest.
        """
        if not self.exists:
            return False
        self._pads.append(pad)
        self._frames.append(sample[self._used])
        if len(self._frames) < WINDOW:
            return False
        r = np.clip(np.sum(self._frames, axis=0), -16384, 16384)
        worst = min(self._pads)
        self._frames, self._pads = [], []
        self._end_window(r, worst, is_gain_followed, gain)
        coefficient = self._coefficient.copy()
        coefficient[:, 0] = 0
        self.factor = limited(UNIT_GAIN + round_shift(coefficient @ self._q_nodes, 16)).reshape(3, *self._nodes)
        if (np.abs(self.factor - self._in_force) < SETTLED).all():
            return False
        self._in_force = self.factor
        return True

    def _fit(self, r: I64) -> tuple[I64, I64]:
        """Terms (15,) in Q24 and the fitted samples (n,) in Q16."""
        median = np.sort(r)[len(r) // 2]
        fitted, a = np.full_like(r, median), np.zeros(TERMS, np.int64)
        for i in range(3):
            e = r - fitted
            e = np.clip(e, -WIDE, WIDE) if i == 0 else np.where(np.abs(e) > GATE, 0, e)
            product = self._q @ e
            for k in np.flatnonzero(self._square):
                a[k] += _half_up(product[k] << 20, int(self._square[k]))
            fitted = median + round_shift(a @ self._q, 20)
        a[0] += median * 256
        return a, fitted

    def _end_window(self, r: I64, pad: int, is_gain_followed: bool, gain: I64) -> None:
        if pad == 0:
            return self._extrapolate(gain)
        fits = [self._fit(channel) for channel in r.T]
        a = np.stack([terms for terms, _ in fits])
        fitted = np.stack([values for _, values in fits], axis=1)
        n_out = int((np.abs(r - fitted) > EDGE).any(axis=1).sum())
        level = np.array([np.sort(c)[len(c) // 2] for c in r.T])
        level = level + round_shift(a[:, 0] - 256 * level, 8)
        farthest = int(np.abs(fitted - level).max())
        if 32 * n_out > len(r):
            if pad == 2:
                self.is_far = farthest > UNLIKE
            return self._extrapolate(gain)
        self.is_far = farthest > FAR
        if self.is_far and pad == 1:
            return self._extrapolate(gain)
        return self._follow(a, is_gain_followed, gain)

    def _follow(self, a: I64, is_gain_followed: bool, gain: I64) -> None:
        self.n_learned += 1
        self.is_at_limit = self.is_stale = False
        self._extrapolated[:] = 0
        whole = a >> 2
        step = np.clip(whole, -MAX_STEP, MAX_STEP)
        is_steady = step == whole
        if is_gain_followed:
            step[:, 0] = (gain - self._gain_before) * 16
            is_steady[:, 0] = np.abs(step[:, 0]) <= MAX_STEP
        else:
            gain[:] = limited(gain + (step[:, 0] >> 4))
        self._coefficient[:, 1:] += step[:, 1:]
        self._rate += np.where(is_steady, (step * 256 - self._rate) >> 6, 0)
        self.is_at_limit = bool((np.abs(self._coefficient) > MAX_COEFFICIENT).any())
        self._coefficient = np.clip(self._coefficient, -MAX_COEFFICIENT, MAX_COEFFICIENT)
        self._gain_before = gain.copy()

    def _extrapolate(self, gain: I64) -> None:
        self.n_extrapolated += 1
        before = self._extrapolated.copy()
        self._extrapolated += self._rate
        self._rate -= self._rate >> 8
        step = (self._extrapolated >> 8) - (before >> 8)
        self._coefficient[:, 1:] = np.clip(self._coefficient + step, -MAX_COEFFICIENT, MAX_COEFFICIENT)[:, 1:]
        gain[:] = limited(gain + (self._extrapolated[:, 0] >> 12) - (before[:, 0] >> 12))
        self.is_stale |= bool((np.abs(self._extrapolated) > STALE).any())
        self._gain_before = gain.copy()
