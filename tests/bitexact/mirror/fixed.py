"""The one rounding rule and the one saturation rule."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

I64 = npt.NDArray[np.int64]


def round_shift(x: I64, shift: int) -> I64:
    """x / 2^shift, half up."""
    return np.asarray((x + (1 << (shift - 1))) >> shift)


def div_half_up(numerator: I64, denominator: I64 | int) -> I64:
    """numerator / denominator, half up, for positive denominators."""
    return np.asarray((2 * numerator + denominator) // (2 * np.asarray(denominator)))


class Saturations:
    """Counts what hit a limit, as the core's SaturationCounter."""

    def __init__(self) -> None:
        self.count = 0

    def clamp(self, x: I64, low: int, high: int) -> I64:
        self.count += int(np.count_nonzero((x < low) | (x > high)))
        return np.clip(x, low, high)

    def int16(self, x: I64) -> I64:
        return self.clamp(x, -(1 << 15), (1 << 15) - 1)

    def int32(self, x: I64) -> I64:
        return self.clamp(x, -(1 << 31), (1 << 31) - 1)
