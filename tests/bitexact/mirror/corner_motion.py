"""Motion of the camera by the pad's corners: firmware/stages/feature_wrench/corner_motion.h."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.fixed import I64

SIDE, WIDE = 7, 9


def _corner(moved: I64, lost: npt.NDArray[np.bool_], pitch: tuple[int, int]) -> tuple[int, int, int, int]:
    """Shift x, y, turn and zoom of `moved` (n, n, 2)."""
    n = len(moved)
    if 4 * int(lost.sum()) > n * n:
        return 0, 0, 0, 0
    at = 2 * np.arange(n) - (n - 1)
    square = int((at * at).sum()) * n

    def slope(sum_: int, pitch: int) -> int:
        return min(max((min(max(sum_, -(2**40)), 2**40) << 20) // (square * pitch), -(2**20)), 2**20)

    along_x, along_y = ((moved * a).sum(axis=(0, 1)) for a in (at[None, :, None], at[:, None, None]))
    x, y = (min(max(int(v) // (n * n), -(2**24)), 2**24) for v in moved.sum(axis=(0, 1)))
    turn = slope(int(along_x[1]), pitch[0]) - slope(int(along_y[0]), pitch[1])
    return x, y, turn, slope(int(along_x[0]), pitch[0]) + slope(int(along_y[1]), pitch[1])


def common_part(parts: list[int]) -> int:
    """firmware/estimators/common_part.h."""
    ordered = sorted(parts)
    return ordered[1] if ordered[1] > 0 else max(-ordered[2], 0)


def motion(rest: I64, moved: I64, lost: npt.NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Of (n_y, n_x, 2) places and displacements, px Q16: shift x, y in px Q16, turn and zoom in Q20."""
    n_y, n_x = lost.shape
    if min(n_x, n_y) < 2 * WIDE:
        return 0, 0, 0, 0
    way = rest[-1, -1] - rest[0, 0]
    pitch = max(int(way[0]) // (n_x - 1), 1), max(int(way[1]) // (n_y - 1), 1)
    found = []
    for is_below in (False, True):
        for is_right in (False, True):
            at = [tuple(slice(-n, None) if is_last else slice(0, n) for is_last in (is_below, is_right))
                  for n in (SIDE, WIDE)]  # fmt: skip
            small, wide = (_corner(moved[part], lost[part], pitch) for part in at)
            more = 7 * (small[3] - wide[3])
            beyond = small[3] + (more // 4 if more >= 0 else -(-more // 4))  # as C++ divides
            found.append((*small[:3], min(max(beyond, 0), small[3]) if small[3] > 0 else max(min(beyond, 0), small[3])))
    return tuple(common_part([f[k] for f in found]) for k in range(4))  # type: ignore[return-value]


def has_moved(rest: I64, moved: I64, lost: npt.NDArray[np.bool_], force_un: I64, gain: I64, shift: I64,
              full_scale: I64) -> bool:  # fmt: skip
    """`gain` (6, 2 n) and `shift` (6,) of kind "wrench"; `force_un` (3,)."""
    n_y, n_x = lost.shape
    if min(n_x, n_y) < 2 * WIDE:
        return False
    seen = motion(rest, moved, lost)
    away = (rest - (rest[0, 0] + rest[-1, -1]) // 2) >> 6
    one, none = np.full((n_y, n_x), 1 << 16), np.zeros((n_y, n_x), np.int64)
    shown = ((one, none), (none, one), (-away[..., 1], away[..., 0]), (away[..., 0], away[..., 1]))
    size = seen[0], seen[1], seen[2], seen[3] + (seen[2] * seen[2] >> 21)
    limit = 90_000 + int(np.minimum(np.abs(force_un), 2**36).sum()) // 12
    for axis in range(3):
        made = 0
        for (x, y), n, bits in zip(shown, size, (16, 16, 14, 14), strict=True):
            total = int((gain[axis].reshape(n_y, n_x, 2) * np.stack([x, y], axis=-1)).sum())
            fine = min(max((total + (1 << int(shift[axis]) >> 1)) >> int(shift[axis]), -(2**36)), 2**36)
            answer = (fine + 8) >> 4 if full_scale[axis] > 0 else 0
            made += min(abs(answer), 2**36) * n >> bits
        if made > limit:
            return True
    return False
