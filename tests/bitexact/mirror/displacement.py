"""Markers and depth -> displacement of the observed nodes in the pad's frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.board import Board, center_q16, depth_grid, observed_nodes
from mirror.camera_map import CameraMap
from mirror.field_repair import least_outlier, repaired
from mirror.fixed import I64, Saturations, round_shift
from mirror.markers import ABSENT, DX, DY, LOST, X, Y
from mirror.scattered import weights

ONE = 16384  # Q14
PLACE_ROUNDS = 8


def tap_weights(position_q16: I64, n_lines: int) -> I64:
    """Catmull-Rom weights Q14 of each position on each lattice line, (n, n_lines).

    A missing line is 2 u_0 - u_1; beyond the lattice the field is linear, for at most one pitch.
    """
    position = np.clip(position_q16, -65536, n_lines * 65536)
    base = np.clip(position >> 16, 0, n_lines - 2)
    t = (position - (base << 16)) >> 2
    t2 = t * t >> 14
    t3 = t2 * t >> 14
    # One column more at either end for the missing lines.
    weights = np.zeros((len(t), n_lines + 2), np.int64)
    row = np.arange(len(t))
    is_inside = (t >= 0) & (t <= ONE)
    cubic = [
        (-t + 2 * t2 - t3) >> 1,
        (2 * ONE - 5 * t2 + 3 * t3) >> 1,
        (t + 4 * t2 - 3 * t3) >> 1,
        (t3 - t2) >> 1,
    ]
    linear = [0 * t, ONE - t, t, 0 * t]
    for tap in range(4):
        weights[row, base + tap] = np.where(is_inside, cubic[tap], linear[tap])
    weights[:, 1] += 2 * weights[:, 0]
    weights[:, 2] -= weights[:, 0]
    weights[:, -2] += 2 * weights[:, -1]
    weights[:, -3] -= weights[:, -1]
    weights = weights[:, 1:-1]
    # What rounding lost goes to the nearer line.
    weights[row, np.where(t < ONE // 2, base, base + 1)] += ONE - weights.sum(axis=1)
    return weights


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


def _to_pad_q3(board: Board, length_um_px_q19: I64) -> I64:
    """length / f in 1/8 micrometre."""
    inverse_focal = (1 << 32) * 1000 // board["camera"]["focal_mpx"]
    return round_shift(round_shift(length_um_px_q19, 10) * inverse_focal, 38)


def marker_displacement(
    board: Board,
    markers: npt.NDArray[np.integer],
    depth: I64 | None,
    saturations: Saturations,
    camera_map: CameraMap | None,
) -> I64:
    """(n_markers, 3), 1/8 micrometre."""
    m = markers.astype(np.int64)
    x, y = m[:, X] + m[:, DX], m[:, Y] + m[:, DY]
    if camera_map is not None:
        rest, now = camera_map.at(m[:, X], m[:, Y]), camera_map.at(x, y)
        place = camera_map.ideal_place(now)
        z = read_depth(board, depth, place[:, 0], place[:, 1])
        moved = now[:, :2] - rest[:, :2] + round_shift(now[:, 2:] * z[:, None], 15)
        return np.column_stack([saturations.int16(round_shift(moved, 5)), z])
    uz = read_depth(board, depth, x, y)

    def to_pad(moved: I64, from_center: I64) -> I64:
        wide = moved * board["camera"]["standoff_um"] * 8 + from_center * uz
        return saturations.int16(_to_pad_q3(board, wide))

    ux = to_pad(m[:, DX], x - center_q16(board, "x"))
    uy = to_pad(m[:, DY], y - center_q16(board, "y"))
    return np.stack([ux, uy, uz], axis=1)


def _node_axis(board: Board, axis: str) -> tuple[I64, I64]:
    """Of the observed node lines: places from the pad's centre, 1/8 um, and on the lattice, Q16."""
    m = board["markers"]
    steps = board["grid"][f"n_{axis}"] - 1
    size, first, pitch = board["pad"][f"size_{axis}_um"], m[f"first_{axis}_um"], m[f"pitch_{axis}_um"]
    i = np.array(observed_nodes(board, axis), dtype=np.int64)
    place = (16 * i * size - 8 * size * steps) // (2 * steps)
    return place, (i * size - first * steps) * 65536 // (pitch * steps)


def _on_lattice(board: Board, a_q16: I64, b_q16: I64) -> I64:
    """Weights Q28 of the markers at each (a, b), Catmull-Rom along each axis, (n, markers)."""
    weight_x = tap_weights(a_q16, board["markers"]["n_x"])
    weight_y = tap_weights(b_q16, board["markers"]["n_y"])
    return np.asarray(weight_y[:, :, None] * weight_x[:, None, :]).reshape(len(a_q16), -1)


def _interpolate(weight: I64, values: I64) -> I64:
    """Of the markers' values (markers, k) at each node."""
    return round_shift(np.asarray(weight @ values, np.int64), 28)


def _node_places(board: Board) -> tuple[I64, I64, I64, I64]:
    """Places of all nodes, x and y, and where they lie on the board's lattice, a and b."""
    (x, a), (y, b) = _node_axis(board, "x"), _node_axis(board, "y")
    shape = (len(y), len(x))
    node_x, a = (np.broadcast_to(v, shape).ravel().copy() for v in (x, a))
    node_y, b = (np.broadcast_to(v[:, None], shape).ravel().copy() for v in (y, b))
    return node_x, node_y, a, b


def marker_weights(board: Board, rest: I64, is_there: npt.NDArray[np.bool_]) -> I64:
    """What each marker counts at each node, Q28, (nodes, markers)."""
    m = board["markers"]
    node_x, node_y, a, b = _node_places(board)
    if m.get("layout", "lattice") == "scattered":
        out = np.zeros((len(node_x), len(rest)), np.int64)
        for node, place in enumerate(zip(node_x.tolist(), node_y.tolist(), strict=True)):
            for marker, weight in weights(place, rest, is_there).items():
                out[node, marker] = weight
        return out
    for _ in range(PLACE_ROUNDS):
        here = _interpolate(_on_lattice(board, a, b), rest)
        a += (node_x - here[:, 0]) * 65536 // (8 * m["pitch_x_um"])
        b += (node_y - here[:, 1]) * 65536 // (8 * m["pitch_y_um"])
        a, b = np.clip(a, -65536, m["n_x"] * 65536), np.clip(b, -65536, m["n_y"] * 65536)
    return _on_lattice(board, a, b)


def _rest(board: Board, markers: npt.NDArray[np.integer], camera_map: CameraMap | None) -> I64:
    """Rest places from the pad's centre, (markers, 2), 1/8 micrometre."""
    place = markers[:, [X, Y]].astype(np.int64)
    if camera_map is not None:
        rest = round_shift(camera_map.at(place[:, 0], place[:, 1])[:, :2], 5)
    else:
        place -= np.array([center_q16(board, "x"), center_q16(board, "y")])
        rest = _to_pad_q3(board, place * board["camera"]["standoff_um"] * 8)
    return np.asarray(rest, np.int64)


def repair_markers(board: Board, u: I64, markers: npt.NDArray[np.integer]) -> tuple[I64, npt.NDArray[np.bool_]]:
    """Displacement (markers, 3) of a lattice without outliers and holes; what was missing or an outlier (markers,)."""
    m = board["markers"]
    is_lost = markers[:, LOST] != 0
    if m.get("layout", "lattice") != "lattice":
        return u, is_lost
    shape = (m["n_y"], m["n_x"])
    least = least_outlier([m["pitch_x_um"], m["pitch_y_um"]], board["pad"]["thickness_um"])
    shear, is_missing = repaired(u[:, :2].reshape(*shape, 2), is_lost.reshape(shape), least)
    return np.column_stack([np.clip(shear.reshape(-1, 2), -32768, 32767), u[:, 2]]), is_missing.ravel()


def filled(
    board: Board, markers: npt.NDArray[np.integer], is_missing: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.bool_]:
    """Nodes, (rows, columns), whose missing markers' (default: lost) |weights| sum to at least one half."""
    is_missing = markers[:, LOST] != 0 if is_missing is None else is_missing
    weight = np.abs(marker_weights(board, _rest(board, markers, None), markers[:, ABSENT] == 0))
    lost = weight @ is_missing.astype(np.int64)
    shape = (len(observed_nodes(board, "y")), len(observed_nodes(board, "x")))
    return np.asarray(2 * lost >= ONE * ONE).reshape(shape)


def displacement(
    board: Board,
    markers: npt.NDArray[np.integer],
    depth: I64 | None,
    saturations: Saturations,
    camera_map: CameraMap | None = None,
) -> I64:
    """(node rows, node columns, 3), 1/8 micrometre."""
    board = board if camera_map is None else camera_map.ideal
    camera = board["camera"]
    u = marker_displacement(board, markers, depth, saturations, camera_map)
    u, _ = repair_markers(board, u, markers)
    node_x, node_y, _, _ = _node_places(board)
    nodes = _interpolate(marker_weights(board, _rest(board, markers, camera_map), markers[:, ABSENT] == 0), u)
    if depth is not None:
        assert depth.shape == depth_grid(board)
        uz = nodes[:, 2]
        for _ in range(2):
            distance = (camera["standoff_um"] * 8 + uz) * 1000
            px = (node_x + nodes[:, 0]) * camera["focal_mpx"] * 65536 // distance
            py = (node_y + nodes[:, 1]) * camera["focal_mpx"] * 65536 // distance
            uz = read_depth(board, depth, center_q16(board, "x") + px, center_q16(board, "y") + py)
        nodes[:, 2] = uz
    shape = (len(observed_nodes(board, "y")), len(observed_nodes(board, "x")))
    return saturations.int16(nodes).reshape(*shape, 3)
