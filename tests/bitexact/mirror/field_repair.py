"""Outliers of a displacement on a lattice, and values for what is missing; firmware/image/field_repair.h."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, observed_nodes
from mirror.fixed import I64, round_shift

Bools = npt.NDArray[np.bool_]
FRACTION = 4
ROUNDS, SWEEPS = 8, 24
FEWEST_LINES, MOST_PLATE_PART = 5, 4
LIMIT = 32768 << FRACTION
AROUND = [(v, u) for v in (-1, 0, 1) for u in (-1, 0, 1) if (v, u) != (0, 0)]


def _shifted(plane: I64, fill: int) -> list[I64]:
    """The eight neighbours of each place, `fill` beyond the border."""
    n_y, n_x = plane.shape
    wide = np.pad(plane, 1, constant_values=fill)
    return [wide[1 + v : 1 + v + n_y, 1 + u : 1 + u + n_x] for v, u in AROUND]


def _rings(field: I64, known: Bools) -> I64:
    out, reached = field.copy(), known.copy()
    while reached.any() and not reached.all():
        count = np.sum(_shifted(reached.astype(np.int64), 0), axis=0)
        new = ~reached & (count > 0)
        for c in range(field.shape[-1]):
            total = np.sum(_shifted(np.where(reached, out[..., c], 0), 0), axis=0)
            out[new, c] = total[new] // count[new]
        reached |= new
    return out


def _residuals(field: I64) -> I64:
    """Sum of the two middle ones of the four lines, of the shape of the field."""
    n_y, n_x, _ = field.shape
    tall = np.concatenate([2 * field[:1] - field[1:2], field, 2 * field[-1:] - field[-2:-1]])
    wide = np.concatenate([2 * tall[:, :1] - tall[:, 1:2], tall, 2 * tall[:, -1:] - tall[:, -2:-1]], axis=1)

    def at(u: int, v: int) -> I64:
        return wide[1 + v : 1 + v + n_y, 1 + u : 1 + u + n_x]

    lines = np.sort([2 * field - at(u, v) - at(-u, -v) for u, v in ((1, 0), (0, 1), (1, 1), (1, -1))], axis=0)
    return np.asarray(lines[1] + lines[2])


def _squares(field: I64) -> I64:
    residual = _residuals(field)
    return np.asarray((residual[..., :2] ** 2).sum(axis=-1) + ((residual[..., 2:] >> 2) ** 2).sum(axis=-1))


def _outliers(field: I64, known: Bools, least: int) -> Bools:
    """What of `known` stays known; `field` takes what the neighbours say of the others."""
    known = known.copy()
    for _ in range(ROUNDS):
        residual2, n_before = _squares(field), int(known.sum())
        # The largest residual of the known neighbours changes as outliers are taken out, row by row.
        for y, x in np.argwhere(residual2 > (4 * least << FRACTION) ** 2):
            beside = [
                (v, u)
                for v in range(max(y - 1, 0), min(y + 2, known.shape[0]))
                for u in range(max(x - 1, 0), min(x + 2, known.shape[1]))
                if (v, u) != (y, x)
            ]
            if not known[y, x] or any(known[j] and residual2[j] > residual2[y, x] for j in beside):
                continue
            own, tried = int(_squares(field)[y, x]), field.copy()
            tried[y, x] -= _residuals(field)[y, x] >> 2
            squares = _squares(tried)
            left = sorted((int(squares[j]) for j in beside), reverse=True)
            if own > 10 * left[1] or own > 49 * left[2]:
                field[y, x], known[y, x] = tried[y, x], False
        if int(known.sum()) == n_before:
            break
    return known


def _plate(field: I64, known: Bools) -> None:
    n_y, n_x = known.shape
    inside = [(y, x) for y, x in np.argwhere(~known) if 2 <= y < n_y - 2 and 2 <= x < n_x - 2]
    for _ in range(SWEEPS):
        for y, x in inside:
            beside = field[y, x + 1] + field[y, x - 1] + field[y + 1, x] + field[y - 1, x]
            diagonal = field[y + 1, x + 1] + field[y - 1, x + 1] + field[y + 1, x - 1] + field[y - 1, x - 1]
            far = field[y, x + 2] + field[y, x - 2] + field[y + 2, x] + field[y - 2, x]
            field[y, x] = np.clip((8 * beside - 2 * diagonal - far + 10) // 20, -LIMIT, LIMIT - (1 << FRACTION))


def _filled(field: I64, known: Bools) -> I64:
    n_missing = int((~known).sum())
    if n_missing == 0:
        return field
    out = _rings(field, known)
    if MOST_PLATE_PART * n_missing <= known.size:
        _plate(out, known)
    return out


def least_outlier(pitch_um: list[int], thickness_um: int) -> int:
    """Smallest outlier, 1/8 um; beyond all values where the lattice is too coarse to show one."""
    if 8 * max(pitch_um) > 3 * thickness_um:
        return 8 * 32768
    return max(8 * min(pitch_um) // 16, 240)


def repaired(field: I64, is_missing: Bools, least: int) -> tuple[I64, Bools]:
    """Displacement (n_y, n_x, 2 or 3) without outliers and holes, and what was missing or an outlier (n_y, n_x)."""
    known = ~is_missing
    if not known.any():
        return field, is_missing
    wide = _filled(field.astype(np.int64) << FRACTION, known)
    if min(known.shape) >= FEWEST_LINES:
        known = _outliers(wide, known, least)
    if (is_missing != ~known).any():
        wide = _filled(wide, known)
    return np.where(known[..., None], field, round_shift(wide, FRACTION)), ~known


def repaired_nodes(board: Board, u: I64) -> tuple[I64, npt.NDArray[np.uint8]]:
    """Nodes from outside, (n_nodes, 3), without outliers and with what was not measured (-32768) filled.

    With what is filled of each node (rows, columns): 1 along the surface, 2 depth as well. The depth of an outlier
    stays where it is near what fills it.
    """
    u = u.reshape(len(observed_nodes(board, "y")), len(observed_nodes(board, "x")), 3)
    pad = board["pad"]
    least = least_outlier([pad[f"size_{a}_um"] // (board["grid"][f"n_{a}"] - 1) for a in "xy"], pad["thickness_um"])
    is_missing = (u == -32768).any(axis=-1)
    out, is_filled = repaired(np.where(is_missing[..., None], 0, u), is_missing, least)
    is_depth_good = is_filled & ~is_missing & (np.abs(u[..., 2] - out[..., 2]) <= 2 * least)
    out[is_depth_good, 2] = u[is_depth_good, 2]
    return out.reshape(-1, 3), np.where(is_filled, 2, 0).astype(np.uint8) - is_depth_good
