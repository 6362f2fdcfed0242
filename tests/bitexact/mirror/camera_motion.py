"""Whether the camera has moved: firmware/estimators/camera_motion.h."""

from __future__ import annotations

import numpy as np

from mirror.fixed import I64

PER_SIDE, FROM_BORDER, LEAST, SIGMA = 2, 2, 12, 64


def is_moved(residual: I64, mask: I64, force_un: I64) -> bool:
    """`residual` (n_y, n_x, 3) in 1/64 standard deviation, `mask` (n_y, n_x), `force_un` (3,)."""
    n_y, n_x = mask.shape
    if min(n_x, n_y) < LEAST:
        return False
    rows, columns = (np.array([n // 4, n - 1 - n // 4]) for n in (n_y, n_x))
    near, far_x, far_y = FROM_BORDER, n_x - 1 - FROM_BORDER, n_y - 1 - FROM_BORDER
    places = ((rows, near), (rows, far_x), (near, columns), (far_y, columns))
    x, y = (np.array([residual[at][:, c].sum() // PER_SIDE for at in places]) for c in (0, 1))
    n_covered = sum(bool(mask[at].all()) for at in places)
    force = int(np.minimum(np.abs(force_un), 1000 * 10**6).sum())

    def limit(fixed: int, half_per_n: int) -> int:
        return fixed * SIGMA + half_per_n * (SIGMA // 2) * force // 10**6

    def common(sides: I64) -> int:
        ordered = np.sort(sides)
        return int(ordered[1] if ordered[1] > 0 else max(-ordered[2], 0))

    outwards, round_it = np.array([-x[0], x[1], -y[2], y[3]]), np.array([-y[0], y[1], x[2], -x[3]])
    return (
        n_covered >= 3
        or max(np.abs(x).max(), np.abs(y).max()) > limit(40, 16)
        or max(common(x), common(y), common(round_it)) > limit(25, 8)
        or common(outwards) > limit(4, 1)
    )
