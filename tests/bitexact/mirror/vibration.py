"""Vibration of a contact from the greys of two frames (firmware/stages/vibration/vibration.h), in integers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64
from mirror.light import grey
from mirror.log2 import log2_q16

STEP_PX = 4
ONE_LEVEL_LOG2_Q16 = 732_032 + 8 * 65_536  # of 48^2, in Q8
DECIBEL_1E4 = 30_103


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
