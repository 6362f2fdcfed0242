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
        for c in range(2):
            total = np.sum(_shifted(np.where(reached, out[..., c], 0), 0), axis=0)
            out[new, c] = total[new] // count[new]
        reached |= new
    return out


def _residuals2(field: I64) -> I64:
    n_y, n_x, _ = field.shape
    tall = np.concatenate([2 * field[:1] - field[1:2], field, 2 * field[-1:] - field[-2:-1]])
    wide = np.concatenate([2 * tall[:, :1] - tall[:, 1:2], tall, 2 * tall[:, -1:] - tall[:, -2:-1]], axis=1)

    def at(u: int, v: int) -> I64:
        return wide[1 + v : 1 + v + n_y, 1 + u : 1 + u + n_x]

    lines = np.sort([2 * field - at(u, v) - at(-u, -v) for u, v in ((1, 0), (0, 1), (1, 1), (1, -1))], axis=0)
    return np.asarray(((lines[1] + lines[2]) ** 2).sum(axis=-1))


def _outliers(field: I64, known: Bools, least: int) -> Bools:
    """What of `known` stays known."""
    known, tried = known.copy(), np.zeros_like(known)
    for _ in range(ROUNDS):
        residual2 = _residuals2(_rings(field, known))
        is_open = known & ~tried
        largest = np.max(_shifted(np.where(is_open, residual2, 0), 0), axis=0)
        candidate = is_open & (residual2 > (4 * least << FRACTION) ** 2) & (residual2 >= largest)
        if not candidate.any():
            break
        filled = _rings(field, known & ~candidate)
        beside = np.sort(_shifted(_residuals2(filled), 0), axis=0)
        off2 = 16 * ((field - filled) ** 2).sum(axis=-1)
        found = candidate & ((off2 > 9 * beside[-2]) | (off2 > 25 * beside[-3]))
        known &= ~found
        tried = np.zeros_like(tried) if found.any() else tried | candidate
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


def repaired(field: I64, is_missing: Bools, least: int) -> tuple[I64, Bools]:
    """Displacement (n_y, n_x, 2) without outliers and holes, and what was missing or an outlier (n_y, n_x)."""
    known = ~is_missing
    if not known.any():
        return field, is_missing
    wide = field.astype(np.int64) << FRACTION
    if min(known.shape) >= FEWEST_LINES:
        known = _outliers(wide, known, least)
    n_missing = int((~known).sum())
    if n_missing == 0:
        return field, is_missing
    filled = _rings(wide, known)
    if MOST_PLATE_PART * n_missing <= known.size:
        _plate(filled, known)
    return np.where(known[..., None], field, round_shift(filled, FRACTION)), ~known


def repaired_nodes(board: Board, u: I64) -> tuple[I64, Bools]:
    """Nodes from outside, (n_nodes, 3), without outliers and with what was not measured (-32768) filled.

    With the nodes (rows, columns) whose shear is filled.
    """
    u = u.reshape(len(observed_nodes(board, "y")), len(observed_nodes(board, "x")), 3)
    least = 8 * min(board["pad"][f"size_{a}_um"] // (board["grid"][f"n_{a}"] - 1) for a in "xy") // 16
    least = max(least, 240)
    z = np.stack([np.zeros_like(u[..., 2]), u[..., 2]], axis=-1)
    z, _ = repaired(z, z[..., 1] == -32768, 3 * least)
    shear, filled = repaired(u[..., :2], (u[..., :2] == -32768).any(axis=-1), least)
    return np.concatenate([shear, z[..., 1:]], axis=-1).reshape(-1, 3), filled
