"""Modulus of a squeezed object from the dent in a gel (firmware/stages/softness/softness.h), in Python integers."""

from __future__ import annotations

from math import isqrt

import numpy as np

from mirror.fixed import I64
from mirror.log2 import log2_q16

RIM, BLOCKS, HARDEST = 2, 6, -9962
ONE, PER_OCTAVE, MAX_PA, MAX_LOG = 1 << 16, 94_548, 4_000_000_000, 1 << 22
MAX_FEATURE = 1 << 19


def _round_shift(x: int, shift: int) -> int:
    return (x + (1 << (shift - 1))) >> shift


def exp2_q16(x: int) -> int:
    """2^x, x <= 0, by the roots of two whose bits are set."""
    out = 1 << 30
    for k in range(1, 17):
        if x >> (16 - k) & 1:
            out = out * round(2.0 ** (2.0**-k) * 2**30) >> 30
    return 0 if x >> 16 < -30 else out >> (14 - (x >> 16))


def dent(features: I64, n_x: int, n_y: int) -> int:
    """log2 of the squared curvature, plus one; from all cells of B by rows, then G and R."""
    f = np.clip(features, -MAX_FEATURE, MAX_FEATURE).reshape(3, n_y, n_x)[:, RIM : n_y - RIM, RIM : n_x - RIM]
    along_x = f[:, :-1, 1:] + f[:, 1:, 1:] - f[:, :-1, :-1] - f[:, 1:, :-1]
    along_y = f[:, 1:, :-1] + f[:, 1:, 1:] - f[:, :-1, :-1] - f[:, :-1, 1:]
    largest = sorted((along_x**2 + along_y**2).sum(axis=0).ravel().tolist())[-BLOCKS:]
    return log2_q16(sum(largest) // BLOCKS + 1)


class Softness:
    """The six numbers of `softness.map`, and the squeeze so far."""

    def __init__(self, numbers: list[int], n_x: int, n_y: int) -> None:
        self._low, self._high, self._slope, self._rigid, self._sigma, self._gel_pa = numbers
        self._cells = (n_x, n_y)
        self._is_done, self._rise = False, list[tuple[int, int]]()
        self.result = [0] * 7

    def run(self, features: I64, force_un: int, variance_un2: int) -> None:
        if 2 * force_un < self._low:
            self._is_done, self._rise = False, []
        self._is_done |= not self._rise and force_un >= self._high
        if self._is_done or not (self._rise or force_un >= self._low):
            return
        log = (dent(features, *self._cells) >> 1) - _round_shift(self._slope * log2_q16(force_un), 16)
        self._rise.append((log, min(isqrt(variance_un2) * ONE // force_un, ONE)))
        if force_un >= self._high:
            self._finish()

    def discard_rise(self) -> None:
        self._is_done, self._rise = True, []

    def _finish(self) -> None:
        n = len(self._rise)
        share = min(max(sum(log for log, _ in self._rise) // n - self._rigid, -MAX_LOG), MAX_LOG)
        relative = sum(one for _, one in self._rise) // n
        sigma = isqrt(self._sigma**2 + _round_shift(_round_shift(self._slope * relative, 16) * PER_OCTAVE, 16) ** 2)
        moduli = [0 if x > HARDEST else self._modulus(x) for x in (share, share + sigma)]
        low = self._modulus(min(share - sigma, HARDEST))
        self.result = [self.result[0] + 1, n, share, sigma, moduli[0], low, moduli[1]]
        self.discard_rise()

    def _modulus(self, x: int) -> int:
        share = exp2_q16(x)
        return min(max(self._gel_pa * share // (ONE - share), 1), MAX_PA)
