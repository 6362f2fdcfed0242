"""Colour change -> slope: mean of each cell's unmasked pixels, unmixing, table, filling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.board import Board, depth_grid, length_q16
from mirror.fixed import I64, div_half_up, round_shift
from mirror.markers import DX, DY, X, Y

ONE = 16384  # Q14
TABLE_LINES = 65
BEND_LINES = 9
NO_LEVEL = np.zeros(3, np.int64)


@dataclass(frozen=True)
class Bend:
    """Lattice (9, 9, 9, 2) Q14 over the changes of B, G, R; `axis` (2, 3): first line in Q12, shift to the next."""

    lattice: npt.NDArray[np.int16]
    axis: npt.NDArray[np.int32]

    def of(self, change: I64) -> I64:
        """(..., 2) Q14 of (..., 3) changes in Q16."""
        low, shift = self.axis.astype(np.int64)
        t = np.stack([round_shift(change[..., c] - 16 * low[c], int(shift[c]) - 5) for c in range(3)], axis=-1)
        t = np.clip(t, 0, (BEND_LINES - 1) << 9)
        line = np.minimum(t >> 9, BEND_LINES - 2)
        value, fraction = self.lattice.astype(np.int64), (t - (line << 9))[..., None]
        b, g, r = np.moveaxis(line, -1, 0)
        fb, fg, fr = np.moveaxis(fraction, -2, 0)
        planes = []
        for i in (0, 1):
            edges = [
                round_shift(value[b + i, g + j, r] * (512 - fr) + value[b + i, g + j, r + 1] * fr, 4) for j in (0, 1)
            ]
            planes.append(round_shift(edges[0] * (512 - fg) + edges[1] * fg, 9))
        return round_shift(planes[0] * (512 - fb) + planes[1] * fb, 14)


def unmix_of_cells(board: Board, unmix: npt.NDArray[np.int16]) -> I64:
    """The coarse lattice, bilinear at each cell's middle: (n_y, n_x, 2, 3)."""
    cells = unmix.astype(np.int64)
    step, camera = board["depth"]["step_px"], board["camera"]
    n_y, n_x = depth_grid(board)
    v, fv = _lattice_place(n_y, step, camera["height_px"], cells.shape[0])
    u, fu = _lattice_place(n_x, step, camera["width_px"], cells.shape[1])
    fu, fv = fu[None, :, None, None], fv[:, None, None, None]
    along_x = cells[:, u] * (65536 - fu) + cells[:, u + 1] * fu
    both = np.asarray(along_x[v] * (65536 - fv) + along_x[v + 1] * fv, np.int64)
    return round_shift(both, 32)


def _lattice_place(n_cells: int, step: int, n: int, lines: int) -> tuple[I64, I64]:
    t = (2 * np.arange(n_cells, dtype=np.int64) * step + step - 1) * (lines - 1) * 65536 // (2 * (n - 1))
    line = np.minimum(t >> 16, lines - 2)
    return line, t - (line << 16)


def table_slope(q: I64, table: npt.NDArray[np.int16]) -> I64:
    """(n_y, n_x, 2), Q12, of q in Q14."""
    q = np.clip(q, -ONE, ONE) + ONE
    at = np.minimum(q >> 9, TABLE_LINES - 2)
    fx, fy = (q[..., k] - (at[..., k] << 9) for k in (0, 1))
    column, row = at[..., 0], at[..., 1]
    fx, fy = fx[..., None], fy[..., None]
    t = table.astype(np.int64)
    upper = round_shift(t[row, column] * (512 - fx) + t[row, column + 1] * fx, 4)
    lower = round_shift(t[row + 1, column] * (512 - fx) + t[row + 1, column + 1] * fx, 4)
    return round_shift(upper * (512 - fy) + lower * fy, 14)


def marker_mask(board: Board, markers: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
    """Pixels under a marker where it rests or where it is."""
    camera = board["camera"]
    radius = length_q16(board, board["markers"]["diameter_um"]) * 5 // 8 + 65536
    y, x = np.mgrid[: camera["height_px"], : camera["width_px"]].astype(np.int64) << 16
    mask = np.zeros(x.shape, bool)
    for m in markers.astype(np.int64):
        for cx, cy in ((m[X], m[Y]), (m[X] + m[DX], m[Y] + m[DY])):
            mask |= (x - cx) ** 2 + (y - cy) ** 2 <= radius * radius
    return mask


def mean_change(total: I64, count: I64, level: I64) -> I64:
    """d' in Q16 of sums (..., 3) in Q12 over `count` pixels, under light of this level (Q16); of none: whatever."""
    light = 65536 + level
    n = np.arange(1, 17)[:, None]
    per_count = np.concatenate([np.zeros((1, 3), np.int64), ((2 << 36) + n * light) // (2 * n * light)])
    return np.asarray(round_shift(total * per_count[count], 16) - (2 * 65536 * level + light) // (2 * light))


def cell_slope(
    board: Board,
    change: I64,
    mask: npt.NDArray[np.bool_],
    unmix: I64,
    table: npt.NDArray[np.int16],
    bend: Bend | None = None,
    level: I64 = NO_LEVEL,
) -> I64:
    """Slope of the mean of each cell's unmasked pixels; empty cells from their nearest neighbours along each axis."""
    step = board["depth"]["step_px"]
    n_y, n_x = depth_grid(board)
    change, mask = change[: n_y * step, : n_x * step], mask[: n_y * step, : n_x * step]
    tiles = (n_y, step, n_x, step)
    count = (~mask).reshape(tiles).sum(axis=(1, 3))
    total = np.where(mask[..., None], 0, change).reshape(*tiles, 3).sum(axis=(1, 3))
    d = mean_change(total, count, level)
    q = round_shift((unmix * d[:, :, None, :]).sum(axis=3), 14)
    out = table_slope(q if bend is None else q + bend.of(d), table)
    filled = out.copy()
    for y, x in np.argwhere(count == 0):
        weight, value = 0, np.zeros(2, np.int64)
        for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
            d = 1
            while 0 <= y + d * dy < n_y and 0 <= x + d * dx < n_x and count[y + d * dy, x + d * dx] == 0:
                d += 1
            if 0 <= y + d * dy < n_y and 0 <= x + d * dx < n_x:
                weight += 4096 // d
                value += 4096 // d * out[y + d * dy, x + d * dx]
        filled[y, x] = div_half_up(value, weight) if weight else 0
    return filled


def cell_depth(board: Board, change: I64, table: npt.NDArray[np.int16], level: I64 = NO_LEVEL) -> I64:
    """Depth in 1/8 um of the mean change over a cell and its channels: lines from -1 to +1."""
    step = board["depth"]["step_px"]
    n_y, n_x = depth_grid(board)
    total = change[: n_y * step, : n_x * step].reshape(n_y, step, n_x, step, 3).sum(axis=(1, 3))
    d = mean_change(total, np.full((n_y, n_x), step * step), level).sum(axis=-1)
    t = np.clip(d + 3 * 65536, 0, 6 * 65536)
    line = np.minimum(t // 1536, len(table) - 2)
    fraction, lines = t - line * 1536, table.astype(np.int64)
    return np.asarray(div_half_up(lines[line] * (1536 - fraction) + lines[line + 1] * fraction, 1536), np.int64)
