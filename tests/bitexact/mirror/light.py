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
    """B + G + R in 1/16 levels."""
    return np.asarray(16 * frame.sum(axis=2, dtype=np.int64))
