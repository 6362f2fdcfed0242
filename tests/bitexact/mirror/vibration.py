"""Vibration of a contact from the greys of two frames (firmware/stages/vibration/vibration.h), in integers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64
from mirror.light import grey

STEP_PX = 4
ONE_LEVEL_LOG2_Q16 = 732_032 + 8 * 65_536  # of 48^2, in Q8
DECIBEL_1E4 = 30_103


def log2_q16(x: int) -> int:
    """Rounded down, bit by bit, by squares of the mantissa."""
    whole = x.bit_length() - 1
    mantissa = x >> (whole - 30) if whole > 30 else x << (30 - whole)
    out = whole
    for _ in range(16):
        mantissa = mantissa * mantissa >> 30
        above = mantissa >> 31
        mantissa >>= above
        out = 2 * out + above
    return out


def level_cdb(before: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8]) -> int:
    """Hundredths of a decibel, of two frames in a row."""

    def sampled(frame: npt.NDArray[np.uint8]) -> I64:
        height, width = (n // STEP_PX * STEP_PX for n in frame.shape[:2])
        return grey(frame)[:height:STEP_PX, :width:STEP_PX].astype(np.int64)

    d = sampled(now) - sampled(before)
    mean_q4 = 16 * int(d.sum()) // d.size
    variance_q8 = max(256 * int((d * d).sum()) // d.size - mean_q4 * mean_q4, 1)
    above_q16 = log2_q16(variance_q8) - ONE_LEVEL_LOG2_Q16
    return (2 * DECIBEL_1E4 * above_q16 + 100 * 65_536) // (200 * 65_536)
