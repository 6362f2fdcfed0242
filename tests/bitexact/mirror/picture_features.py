"""Change of the light over a grid on the gel (firmware/stages/picture_features/picture_features.h), in integers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.fixed import I64

WEIGHT_BITS = 30
Line = tuple[int, int, int]


def _cross(a: Line, b: Line) -> Line:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Line, b: Line) -> int:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _parts(low: Line, high: Line, vanishing: Line, x: I64, y: I64, n: int) -> I64:
    """Part of each pixel between two edges; -1 outside."""
    weights = [_dot(high, vanishing), -_dot(low, vanishing)]
    excess = max(max(abs(w) for w in weights).bit_length() - WEIGHT_BITS, 0)
    a, b = ((line[0] * x + line[1] * y + line[2]) * (w >> excess) for line, w in zip((low, high), weights, strict=True))
    sign = np.where(a + b < 0, -1, 1)
    a, whole = sign * a, sign * (a + b)
    return np.asarray(np.where((a >= 0) & (a < whole), n * a // np.maximum(whole, 1), -1))


def cells(board: Board) -> I64:
    """Cell of every pixel (height, width), by rows; -1: not on the gel."""
    settings = board["picture_features"]
    top_left, top_right, bottom_right, bottom_left = ((x, y, 1) for x, y in settings["corners_px"])
    top, bottom = _cross(top_left, top_right), _cross(bottom_left, bottom_right)
    left, right = _cross(top_left, bottom_left), _cross(top_right, bottom_right)
    y, x = np.mgrid[: board["camera"]["height_px"], : board["camera"]["width_px"]].astype(np.int64)
    i = _parts(left, right, _cross(top, bottom), x, y, settings["n_x"])
    j = _parts(top, bottom, _cross(left, right), x, y, settings["n_y"])
    return np.asarray(np.where((i < 0) | (j < 0), -1, j * settings["n_x"] + i))


def features(change: npt.NDArray[np.int64], cell: I64, n_cells: int) -> I64:
    """Of the relative change (height, width, 3): cells of B, then of G and of R."""
    is_on = cell >= 0
    n = np.maximum(np.bincount(cell[is_on], minlength=n_cells), 1)
    out = []
    for channel in range(3):
        total = np.zeros(n_cells, np.int64)
        np.add.at(total, cell[is_on], change[..., channel][is_on])
        out.append((32 * total + n) // (2 * n))
    return np.concatenate(out)
