"""rest, difference, grey: what happens to pixels before anything is recognised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64, round_shift

DARK_LEVEL = 8


def rest_image(frames: npt.NDArray[np.uint8]) -> I64:
    """(16 sum + n / 2) / n per channel, in 1/16 grey levels."""
    n = len(frames)
    return np.asarray((16 * frames.sum(axis=0, dtype=np.int64) + n // 2) // n)


def reciprocal(rest: I64) -> I64:
    limited = np.maximum(rest, 512)
    return np.minimum(((1 << 24) + limited // 2) // limited, 32767)


def difference(frame: npt.NDArray[np.uint8], rest: I64, reciprocal_q24: I64) -> tuple[I64, tuple[int, int]]:
    """Relative change Q12, and how many pixels are dark, full."""
    change = round_shift((16 * frame.astype(np.int64) - rest) * reciprocal_q24, 12)
    dark = int((frame < DARK_LEVEL).all(axis=2).sum())
    full = int((frame == 255).any(axis=2).sum())
    return change, (dark, full)


def grey(frame: npt.NDArray[np.uint8]) -> I64:
    """B + 2 G + R in 1/16 levels of three channels."""
    return np.asarray(12 * (frame @ np.array([1, 2, 1], np.int64)))


def grey_of_rest(rest: npt.NDArray[np.uint16]) -> I64:
    """The same of a rest image in 1/16 levels."""
    return np.asarray((3 * (rest @ np.array([1, 2, 1], np.int64)) + 2) >> 2)
