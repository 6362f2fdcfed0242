"""Markers and depth -> displacement of the observed nodes in the pad's frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16, depth_grid, observed_nodes
from mirror.fixed import I64, Saturations, round_shift
from mirror.markers import DX, DY, X, Y

ONE = 16384  # Q14


def tap_weights(position_q16: int, n_lines: int) -> dict[int, int]:
    """Lattice line -> Catmull-Rom weight Q14; a missing line is 2 u_0 - u_1, linear outside."""
    position = min(max(position_q16, -65536), n_lines * 65536)
    base = min(max(position >> 16, 0), n_lines - 2)
    t = (position - (base << 16)) >> 2
    if not 0 <= t <= ONE:
        return {base: ONE - t, base + 1: t}
    t2 = t * t >> 14
    t3 = t2 * t >> 14
    before = (-t + 2 * t2 - t3) >> 1
    first = (2 * ONE - 5 * t2 + 3 * t3) >> 1
    second = (t + 4 * t2 - 3 * t3) >> 1
    after = (t3 - t2) >> 1
    taps = {base: first, base + 1: second}
    if base > 0:
        taps[base - 1] = before
    else:
        taps[base] += 2 * before
        taps[base + 1] -= before
    if base + 2 < n_lines:
        taps[base + 2] = after
    else:
        taps[base + 1] += 2 * after
        taps[base] -= after
    taps[base if t < ONE // 2 else base + 1] += ONE - sum(taps.values())
    return taps


def read_depth(board: Board, depth: I64 | None, x_q16: I64, y_q16: I64) -> I64:
    """Bilinear, 1/8 micrometre; the border's value beyond it."""
    if depth is None:
        return np.zeros_like(x_q16)
    step = board["depth"]["step_px"]

    def cell(px_q16: I64, n: int) -> tuple[I64, I64]:
        at = np.clip((2 * px_q16 - (step - 1) * 65536) // (2 * step), 0, (n - 1) << 16)
        line = np.minimum(at >> 16, n - 2)
        return line, at - (line << 16)

    row, fy = cell(y_q16, depth.shape[0])
    column, fx = cell(x_q16, depth.shape[1])
    upper = depth[row, column] * (65536 - fx) + depth[row, column + 1] * fx
    lower = depth[row + 1, column] * (65536 - fx) + depth[row + 1, column + 1] * fx
    return round_shift(np.asarray(upper * (65536 - fy) + lower * fy, np.int64), 32)


def marker_displacement(
    board: Board, markers: npt.NDArray[np.integer], depth: I64 | None, saturations: Saturations
) -> I64:
    """(n_markers, 3), 1/8 micrometre."""
    m = markers.astype(np.int64)
    camera = board["camera"]
    x, y = m[:, X] + m[:, DX], m[:, Y] + m[:, DY]
    uz = read_depth(board, depth, x, y)
    inverse_focal = (1 << 32) * 1000 // camera["focal_mpx"]

    def to_pad(moved: I64, from_center: I64) -> I64:
        wide = moved * camera["standoff_um"] * 8 + from_center * uz
        return saturations.int16(round_shift(round_shift(wide, 10) * inverse_focal, 38))

    ux = to_pad(m[:, DX], x - center_q16(board, "x"))
    uy = to_pad(m[:, DY], y - center_q16(board, "y"))
    return np.stack([ux, uy, uz], axis=1)


def _axis(board: Board, axis: str) -> tuple[npt.NDArray[np.int64], I64]:
    """Weight matrix (n_nodes, n_lines) Q14 and node places from the pad's centre, 1/8 um."""
    m = board["markers"]
    steps = board["grid"][f"n_{axis}"] - 1
    size = board["pad"][f"size_{axis}_um"]
    nodes = observed_nodes(board, axis)
    weights = np.zeros((len(nodes), m[f"n_{axis}"]), np.int64)
    for row, i in enumerate(nodes):
        place = (i * size - m[f"first_{axis}_um"] * steps) * 65536 // (m[f"pitch_{axis}_um"] * steps)
        for line, weight in tap_weights(place, m[f"n_{axis}"]).items():
            weights[row, line] += weight
    places = np.array([(16 * i * size - 8 * size * steps) // (2 * steps) for i in nodes])
    return weights, places


def displacement(
    board: Board, markers: npt.NDArray[np.integer], depth: I64 | None, saturations: Saturations
) -> I64:
    """(node rows, node columns, 3), 1/8 micrometre."""
    m, camera = board["markers"], board["camera"]
    u = marker_displacement(board, markers, depth, saturations).reshape(m["n_y"], m["n_x"], 3)
    weight_x, node_x = _axis(board, "x")
    weight_y, node_y = _axis(board, "y")
    wide = np.einsum("rj,ci,jik->rck", weight_y, weight_x, u)
    nodes = round_shift(wide, 28)
    if depth is not None:
        assert depth.shape == depth_grid(board)
        uz = nodes[..., 2]
        for _ in range(2):
            distance = (camera["standoff_um"] * 8 + uz) * 1000
            px = (node_x[None, :] + nodes[..., 0]) * camera["focal_mpx"] * 65536 // distance
            py = (node_y[:, None] + nodes[..., 1]) * camera["focal_mpx"] * 65536 // distance
            uz = read_depth(board, depth, center_q16(board, "x") + px, center_q16(board, "y") + py)
        nodes[..., 2] = uz
    return saturations.int16(nodes)
