"""Colour change -> slope: unmixing, table, mean of each cell's unmasked pixels, filling."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, depth_grid, length_q16
from mirror.fixed import I64, div_half_up, round_shift
from mirror.markers import DX, DY, X, Y

ONE = 16384  # Q14
TABLE_LINES = 65


def upsample(unmix: npt.NDArray[np.int16], height: int, width: int) -> I64:
    """The coarse lattice, bilinear at each pixel: (height, width, 2, 3)."""
    cells = unmix.astype(np.int64)
    v, fv = _lattice_place(height, cells.shape[0])
    u, fu = _lattice_place(width, cells.shape[1])
    fu, fv = fu[None, :, None, None], fv[:, None, None, None]
    along_x = cells[:, u] * (65536 - fu) + cells[:, u + 1] * fu
    both = np.asarray(along_x[v] * (65536 - fv) + along_x[v + 1] * fv, np.int64)
    return round_shift(both, 32)


def _lattice_place(n: int, lines: int) -> tuple[I64, I64]:
    t = np.arange(n, dtype=np.int64) * (lines - 1) * 65536 // (n - 1)
    line = np.minimum(t >> 16, lines - 2)
    return line, t - (line << 16)


def pixel_slope(change: I64, unmix: I64, table: npt.NDArray[np.int16]) -> I64:
    """(height, width, 2), Q12."""
    q = round_shift((unmix * change[:, :, None, :]).sum(axis=3), 10)
    q = np.clip(q, -ONE, ONE) + ONE
    at = np.minimum(q >> 9, TABLE_LINES - 2)
    fx, fy = (q[..., k] - (at[..., k] << 9) for k in (0, 1))
    column, row = at[..., 0], at[..., 1]
    fx, fy = fx[..., None], fy[..., None]
    t = table.astype(np.int64)
    upper = t[row, column] * (512 - fx) + t[row, column + 1] * fx
    lower = t[row + 1, column] * (512 - fx) + t[row + 1, column + 1] * fx
    return round_shift(upper * (512 - fy) + lower * fy, 18)


def marker_mask(board: Board, markers: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
    """Pixels under a marker where it rests or where it is."""
    camera = board["camera"]
    radius = length_q16(board, board["markers"]["diameter_um"]) * 3 // 4 + 2 * 65536
    y, x = np.mgrid[: camera["height_px"], : camera["width_px"]].astype(np.int64) << 16
    mask = np.zeros(x.shape, bool)
    for m in markers.astype(np.int64):
        for cx, cy in ((m[X], m[Y]), (m[X] + m[DX], m[Y] + m[DY])):
            mask |= (x - cx) ** 2 + (y - cy) ** 2 <= radius * radius
    return mask


def cell_slope(board: Board, slope: I64, mask: npt.NDArray[np.bool_]) -> I64:
    """Mean of each cell's unmasked pixels; empty cells from the box around them."""
    step = board["depth"]["step_px"]
    n_y, n_x = depth_grid(board)
    slope, mask = slope[: n_y * step, : n_x * step], mask[: n_y * step, : n_x * step]
    tiles = (n_y, step, n_x, step)
    count = (~mask).reshape(tiles).sum(axis=(1, 3))
    total = np.where(mask[..., None], 0, slope).reshape(*tiles, 2).sum(axis=(1, 3))
    out = np.where(count[..., None] > 0, div_half_up(total, np.maximum(count, 1)[..., None]), 0)
    radius_px = length_q16(board, board["markers"]["diameter_um"]) * 3 // 4 + 2 * 65536
    first = max((radius_px >> 16) // step, 1)
    filled = out.copy()
    for y, x in np.argwhere(count == 0):
        r = first
        while r < 2 * (n_x + n_y):
            box = np.s_[max(y - r, 0) : y + r + 1, max(x - r, 0) : x + r + 1]
            here = count[box] > 0
            if here.any():
                filled[y, x] = div_half_up(out[box][here].sum(axis=0), int(here.sum()))
                break
            r *= 2
    return filled
