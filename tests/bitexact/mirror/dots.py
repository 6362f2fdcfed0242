"""Sub-pixel centres of printed dots: box background, threshold, connected components, moments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, length_q16
from mirror.fixed import I64, round_shift

MAX_DOTS = 4096


def detect_dots(board: Board, grey: I64) -> npt.NDArray[np.int32]:
    """Rows of x, y (Q16 px) and area, in the order of each dot's first pixel."""
    markers = board["markers"]
    pitch = length_q16(board, min(markers["pitch_x_um"], markers["pitch_y_um"]))
    diameter = length_q16(board, markers["diameter_um"])
    area = ((diameter * diameter >> 16) * 201 // 256) >> 16
    weight = weigh(grey, max((pitch * 6 // 10) >> 16, 2), markers["threshold_1e3"], markers["polarity"])
    return dots_of(weight, max(area // 4, 4), max(area * 3, 16))


def dots_of(weight: I64, min_area: int, max_area: int) -> npt.NDArray[np.int32]:
    """Rows of x, y (Q16 px) and area of the components of positive weight."""
    label = _components(weight > 0)
    height, width = weight.shape
    y, x = np.mgrid[:height, :width]
    rows = []
    for i in range(1, int(label.max(initial=0)) + 1):
        pixels = label == i
        px, py, w = x[pixels], y[pixels], weight[pixels]
        n = len(px)
        at_border = px.min() == 0 or py.min() == 0 or px.max() == width - 1 or py.max() == height - 1
        if at_border or not min_area <= n <= max_area:
            continue
        total = int(w.sum())
        rows.append(((int((w * px).sum()) << 16) // total, (int((w * py).sum()) << 16) // total, n))
    return np.array(rows[:MAX_DOTS], np.int32).reshape(-1, 3)


def weigh(grey: I64, radius: int, threshold_1e3: int, polarity: str) -> I64:
    """Darkening against the box mean, minus the threshold, where positive."""
    height, width = grey.shape
    table = np.zeros((height + 1, width + 1), np.int64)
    table[1:, 1:] = grey.cumsum(axis=0).cumsum(axis=1)
    top = np.maximum(np.arange(height) - radius, 0)[:, None]
    bottom = np.minimum(np.arange(height) + radius, height - 1)[:, None] + 1
    left = np.maximum(np.arange(width) - radius, 0)[None, :]
    right = np.minimum(np.arange(width) + radius, width - 1)[None, :] + 1
    total = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
    area = (bottom - top) * (right - left)
    background = round_shift(total * (((1 << 33) + area) // (2 * area)), 32)
    contrast = background - grey if polarity == "dark" else grey - background
    return np.asarray(np.maximum(contrast - (background * (threshold_1e3 * 32768 // 1000) >> 15), 0))


def _components(is_dot: npt.NDArray[np.bool_]) -> I64:
    """4-connected components, numbered from 1 in raster order of their first pixel."""
    height, width = is_dot.shape
    label = np.zeros(is_dot.shape, np.int64)
    n = 0
    for start in np.flatnonzero(is_dot):
        y, x = divmod(int(start), width)
        if label[y, x]:
            continue
        n += 1
        label[y, x] = n
        stack = [(y, x)]
        while stack:
            y, x = stack.pop()
            for v, u in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                if 0 <= v < height and 0 <= u < width and is_dot[v, u] and not label[v, u]:
                    label[v, u] = n
                    stack.append((v, u))
    return label
