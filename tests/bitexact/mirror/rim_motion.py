"""Motion of the camera by a fingertip's outermost pins: firmware/stages/fingertip/rim_motion.h."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.corner_motion import common_part
from mirror.fixed import I64

Flags = npt.NDArray[np.bool_]


def rim(rest: I64, absent: Flags) -> list[list[int]]:
    """Numbers of the pins to the right, left, below and above, of `rest` (n, 2) px Q16."""
    sectors: list[list[int]] = [[], [], [], []]
    there = np.flatnonzero(~absent)
    if not len(there):
        return sectors
    away = rest[there] - ((rest[there].min(axis=0) + rest[there].max(axis=0)) >> 1)
    order = np.argsort(-((away >> 8) ** 2).sum(axis=1), kind="stable")[: len(there) // 5]
    for number, (x, y) in zip(there[order], away[order], strict=True):
        sectors[(0 if x > 0 else 1) if abs(x) >= abs(y) else (2 if y > 0 else 3)].append(int(number))
    return sectors


def motion(sectors: list[list[int]], moved: I64, lost: Flags) -> tuple[int, int, int, int]:
    """Shift x, y, zoom and turn of `moved` (n, 2), px Q16."""
    mean = np.zeros((4, 2), np.int64)
    for s, numbers in enumerate(sectors):
        seen = [n for n in numbers if not lost[n]]
        if seen and 2 * len(seen) >= len(numbers):
            mean[s] = moved[seen].sum(axis=0) // len(seen)
    (right, left, below, above) = mean.tolist()
    return (
        common_part(mean[:, 0].tolist()),
        common_part(mean[:, 1].tolist()),
        common_part([right[0], -left[0], below[1], -above[1]]),
        common_part([right[1], -left[1], -below[0], above[0]]),
    )


def has_moved(
    seen: tuple[int, int, int, int], force_un: int, most_un: int, at_max: tuple[int, int] = (78643, 39322)
) -> bool:
    load = (min(max(force_un, 0), most_un) << 16) // most_un
    return max(seen[:2]) > 7864 + (at_max[0] * load >> 16) or max(seen[2:]) > 3932 + (at_max[1] * load >> 16)
