"""How sure the forces are: sigma of each node, covariance of the wrench, on Python's unbounded integers."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.estimators import grid_steps, to_um
from mirror.fixed import I64

LARGEST_FORCE = (1 << 20) - 1
LARGEST_SIGMA = 1 << 28
LARGEST_READING = 1 << 40
LARGEST_PLACE = 1 << 17
REPORTED, QUIET = 12, 7
LISTED, MOST_UNLISTED = 8, 16
FULL = 128
X, Y, Z = range(3)


@dataclass(frozen=True)
class ErrorTables:
    """support.error_* of proto/CALIBRATION.md; first index: shear, normal."""

    reported: npt.NDArray[np.int32]  # (2, 12) steps^2 Q8
    quiet: npt.NDArray[np.int32]  # (2, 7) steps^2 Q8
    local: npt.NDArray[np.int32]  # (2, 4) Q16
    wrench: npt.NDArray[np.int32]  # (4, 2)
    crosstalk: npt.NDArray[np.int32]  # (1,) Q20
    stiffness_q20: int = 0  # relative standard deviation of the pad's stiffness


@dataclass(frozen=True)
class Touch:
    """One contact: centre of pressure in um and pressing force in uN."""

    x_um: int
    y_um: int
    force_z_un: int


def node_sigma(
    tables: ErrorTables, force: I64, filled: npt.NDArray[np.uint8], shape: tuple[int, int], threshold_lsb: int
) -> I64:
    """(n_nodes, 3) in force steps; `filled` of that shape: 1 along the surface, 2 depth as well."""
    limited = np.clip(force, -LARGEST_FORCE, LARGEST_FORCE).reshape(*shape, 3)
    padded = np.pad(limited, ((1, 1), (1, 1), (0, 0)))
    places = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    around = np.stack([padded[dy : dy + shape[0], dx : dx + shape[1]] for dy, dx in places])
    total, beside = around.sum(axis=0), np.abs(around[..., 2]).max(axis=0)
    step = np.abs(around - limited).max(axis=0)
    contrast_z = (8 * limited[..., 2] - total[..., 2]) ** 2 >> 6
    wide = np.pad(contrast_z, 3)
    rough = sum(wide[dy : dy + shape[0], dx : dx + shape[1]] for dy in range(7) for dx in range(7)) >> 6
    out = np.zeros((*shape, 3), np.int64)
    for y, x, c in np.ndindex(*shape, 3):
        axis = c // 2
        f, f_z = int(limited[y, x, c]), int(limited[y, x, 2])
        level = abs(f_z).bit_length()
        if level:
            variance = int(tables.reported[axis, min(level, REPORTED) - 1])
        else:
            variance = int(tables.quiet[axis, min((int(beside[y, x]).bit_length() + 1) // 2, QUIET - 1)])
        weight = min(max(-f_z, 0), threshold_lsb) * FULL // threshold_lsb
        contrast = (8 * f - int(total[y, x, c])) ** 2 >> 6
        reading, by_contrast, by_step, by_rough = (int(v) for v in tables.local[axis])
        local = (reading + ((tables.stiffness_q20**2 + (1 << 23)) >> 24)) * f * f
        local += by_contrast * ((weight * contrast + 64) >> 7)
        local += by_step * int(step[y, x, c]) ** 2
        local += by_rough * ((weight * int(rough[y, x]) + 64) >> 7)
        sigma = max((isqrt(variance + (local >> 8)) + 8) >> 4, 1)
        near = filled[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        halves = (5, 8)[axis] if filled[y, x] > axis else 3 if near.max() > axis else 2
        out[y, x, c] = (sigma * halves + 1) // 2
    return out.reshape(-1, 3)


def filled_force(board: Board, force: I64, filled: npt.NDArray[np.uint8]) -> list[int]:
    """Sums of |fx|, |fy|, |fz| (uN) and of y |fx|, x |fy|, y |fz|, x |fz| (uN um) over `filled` nodes."""
    size = np.abs(force.reshape(*filled.shape, 3)) * np.array([filled > 0, filled > 0, filled > 1]).transpose(1, 2, 0)
    x, size_x, steps_x = grid_steps(board, "x")
    y, size_y, steps_y = grid_steps(board, "y")
    lsb = board["field"]["force_lsb_un"]

    def arm(c: int, along: int) -> int:
        if along == X:
            return to_um(int((size[..., c] * x[None, :]).sum()) * lsb, size_x, steps_x)
        return to_um(int((size[..., c] * y[:, None]).sum()) * lsb, size_y, steps_y)

    return [*(int(t) * lsb for t in size.sum(axis=(0, 1))), arm(X, Y), arm(Y, X), arm(Z, Y), arm(Z, X)]


def touches_of(board: Board, mask: I64, force: I64) -> list[Touch]:
    """Every 8-connected component of the mask in which a node presses, most of them first, then first node."""
    x, size_x, steps_x = grid_steps(board, "x")
    y, size_y, steps_y = grid_steps(board, "y")
    f = force.reshape(*mask.shape, 3)
    seen = mask == 0
    found = []
    for start in zip(*np.nonzero(mask), strict=True):
        if seen[start]:
            continue
        nodes, stack = [], [start]
        seen[start] = True
        while stack:
            row, column = stack.pop()
            nodes.append((row, column))
            for v in range(max(row - 1, 0), min(row + 2, mask.shape[0])):
                for u in range(max(column - 1, 0), min(column + 2, mask.shape[1])):
                    if not seen[v, u]:
                        seen[v, u] = True
                        stack.append((v, u))
        pressing = [(int(f[n][2]), *n) for n in nodes if f[n][2] < 0]
        if not pressing:
            continue
        total = -sum(p for p, _, _ in pressing)
        at_x = -to_um(sum(p * int(x[c]) for p, _, c in pressing), size_x, steps_x) // total
        at_y = -to_um(sum(p * int(y[r]) for p, r, _ in pressing), size_y, steps_y) // total
        force_z = sum(int(f[n][2]) for n in nodes) * board["field"]["force_lsb_un"]
        found.append((len(pressing), Touch(at_x, at_y, force_z)))
    return [touch for _, touch in sorted(found, key=lambda t: -t[0])]


def _rounded(numerator: int, denominator: int) -> int:
    return (2 * numerator + denominator) // (2 * denominator)


def _limited(x: int, limit: int = LARGEST_SIGMA) -> int:
    return max(-limit, min(limit, x))


def wrench_covariance(
    tables: ErrorTables,
    board: Board,
    wrench: list[int],
    touches: list[Touch],
    n_found: int,
    of_filled: list[int],
) -> I64:
    """(21,) upper triangle by rows, (uN, uN mm)^2; `touches` are the listed ones.

    `of_filled`: of `filled_force`.
    """
    (shear, normal), moment, lever, factor = ([int(v) for v in row] for row in tables.wrench)
    vectors: list[tuple[int, list[int]]] = []

    def part(factor: int, reading: int, fraction: int = 20) -> int:
        return _limited((factor * _limited(reading, LARGEST_READING) + (1 << (fraction - 1))) >> fraction)

    fx, fy, fz, tx, ty, tz = [*wrench[:3], *(_rounded(t, 1000) for t in wrench[3:])]
    vectors.append((1, [part(factor[0], v) for v in (fx, fy, 0, 0, 0, tz)]))
    vectors.append((1, [part(factor[1], v) for v in (0, 0, fz, tx, ty, 0)]))
    vectors.append((1, [part(tables.stiffness_q20, v) for v in (fx, fy, fz, tx, ty, tz)]))
    hole_x, hole_y, hole_z = of_filled[:3]
    y_of_x, x_of_y, y_of_z, x_of_z = (_rounded(t, 1000) for t in of_filled[3:])
    vectors.append((1, [part(32, hole_x, 8), 0, 0, 0, 0, -part(32, y_of_x, 8)]))
    vectors.append((1, [0, part(32, hole_y, 8), 0, 0, 0, part(32, x_of_y, 8)]))
    vectors.append((1, [0, 0, part(22, hole_z, 8), part(22, y_of_z, 8), -part(22, x_of_z, 8), 0]))
    for touch in touches if n_found else [Touch(0, 0, 0)]:
        x, y = _limited(touch.x_um, LARGEST_PLACE), _limited(touch.y_um, LARGEST_PLACE)
        for err in (shear, part(int(tables.crosstalk[0]), touch.force_z_un)):
            vectors.append((1, [err, 0, 0, 0, 0, _limited(_rounded(-y * err, 1000))]))
            vectors.append((1, [0, err, 0, 0, 0, _limited(_rounded(x * err, 1000))]))
        arms = [_limited(_rounded(arm * normal, 1000)) for arm in (y, -x)]
        vectors.append((1, [0, 0, normal, *arms, 0]))
        for axis, which in ((3, 0), (4, 0), (5, 1)):
            arm = _limited(_rounded(lever[which] * _limited(touch.force_z_un, LARGEST_READING), 10**6))
            vectors += [(1, [v if i == axis else 0 for i in range(6)]) for v in (moment[which], arm)]
    if n_found > LISTED:
        x_mm, y_mm = (_limited(board["pad"][f"size_{a}_um"] // 2, LARGEST_PLACE) // 1000 + 1 for a in "xy")
        about = [max(normal * y_mm, moment[0]), max(normal * x_mm, moment[0]), max(shear * (x_mm + y_mm), moment[1])]
        each = [shear, shear, normal, *about]
        n = min(n_found - LISTED, MOST_UNLISTED)
        vectors += [(n, [_limited(v) if i == axis else 0 for i in range(6)]) for axis, v in enumerate(each)]
    upper = [sum(n * v[i] * v[j] for n, v in vectors) for i in range(6) for j in range(i, 6)]
    return np.array(upper, np.int64)
