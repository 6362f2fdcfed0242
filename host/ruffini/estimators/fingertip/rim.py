"""How far presses move the outermost pins: what firmware/stages/fingertip/rim_motion.h allows a load.

The same sectors and quantities in floating point: what is fitted needs a margin, not the last bit.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PART = 5  # of a view's pins are its rim
AT_REST_PX = np.array([0.12, 0.06])  # shift and zoom that are allowed without a load
LEAST_PX = np.array([1.2, 0.6])  # at the largest force; the default of the firmware
LEAST_LOAD = 0.2  # of the largest force: at less a small motion of the camera would count as a large one under load
PART_OF_FRAMES = 0.98  # whose motion is allowed: a camera that moved in one press teaches nothing
MARGIN = 1.25  # over them
MOST_PX = 6.0  # whatever the presses do


def rim_motion(rest: Array, moved: Array) -> Array:
    """Largest shift, and largest zoom or turn, of a view's rim in each frame, px, (t, 2).

    rest : (n, 2) px. moved : (t, n, 2) px from there.
    """
    away = rest - (rest.min(axis=0) + rest.max(axis=0)) / 2
    outer = np.argsort(-(away**2).sum(axis=1), kind="stable")[: len(rest) // PART]
    x, y = away[outer].T
    is_beside = np.abs(x) >= np.abs(y)
    sectors = (is_beside & (x > 0), is_beside & (x <= 0), ~is_beside & (y > 0), ~is_beside & (y <= 0))
    right, left, below, above = (
        moved[:, outer[s]].mean(axis=1) if s.any() else np.zeros((len(moved), 2)) for s in sectors
    )
    shift = [_common(right[:, i], left[:, i], below[:, i], above[:, i]) for i in range(2)]
    zoom = _common(right[:, 0], -left[:, 0], below[:, 1], -above[:, 1])
    turn = _common(right[:, 1], -left[:, 1], -below[:, 0], above[:, 0])
    return np.stack([np.maximum(*shift), np.maximum(zoom, turn)], axis=1)


def _common(*parts: Array) -> Array:
    """firmware/estimators/common_part.h of each frame, (t,)."""
    ordered = np.sort(np.stack(parts), axis=0)
    return np.asarray(np.where(ordered[1] > 0, ordered[1], np.maximum(-ordered[2], 0)))


def rim_at_most(motion: Array, load: Array) -> Array:
    """Shift and zoom that a load of 1, the largest force, is allowed, px, (2,).

    motion : (t, 2) of `rim_motion`. load : (t,) force over the largest, above 0.
    """
    is_heavy = load >= LEAST_LOAD
    if not is_heavy.any():
        return LEAST_PX
    slope = (motion[is_heavy] - AT_REST_PX) / load[is_heavy, None]
    return np.asarray(np.clip(MARGIN * np.quantile(slope, PART_OF_FRAMES, axis=0), LEAST_PX, MOST_PX))
