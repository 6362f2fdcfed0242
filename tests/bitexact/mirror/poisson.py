"""Slope -> depth: perspective gradient, divergence, cosine transform, tridiagonal solve, gauge."""

from __future__ import annotations

import numpy as np

from mirror.board import Board, depth_grid
from mirror.fixed import I64, Saturations, round_shift

ONE_Q14 = 16384
MAX_FOLD = ONE_Q14 * 9 // 10


def cos_pi_q30(numerator: I64, denominator: int) -> I64:
    """The integer nearest to 2^30 cos(pi numerator / denominator)."""
    angle = np.longdouble("3.14159265358979323846264338327950288") * (numerator % (2 * denominator)) / denominator
    return np.asarray(np.floor(np.cos(angle) * 2**30 + np.longdouble(0.5)), np.int64)


def ray_slopes(board: Board, axis: str, n: int) -> I64:
    """Slope, Q16, of the ray through the middle of each depth cell."""
    camera, step = board["camera"], board["depth"]["step_px"]
    middle_mpx = (2 * np.arange(n, dtype=np.int64) * step + step - 1) * 500
    return np.asarray((middle_mpx - camera[f"center_{axis}_mpx"]) * 65536 // camera["focal_mpx"])


def gradient(board: Board, slope: I64, saturations: Saturations) -> I64:
    """(n_y, n_x, 2), micrometres per cell, Q10."""
    n_y, n_x = slope.shape[:2]
    camera = board["camera"]
    cell_q10 = camera["standoff_um"] * board["depth"]["step_px"] * 1024 * 1000 // camera["focal_mpx"]
    ray_x, ray_y = ray_slopes(board, "x", n_x)[None, :], ray_slopes(board, "y", n_y)[:, None]
    fold = np.minimum(round_shift(slope[..., 0] * ray_x + slope[..., 1] * ray_y, 14), MAX_FOLD)
    scale = (1 << 30) // (ONE_Q14 - fold) * cell_q10
    return saturations.clamp(round_shift(slope * scale[..., None], 28), -(1 << 20), 1 << 20)


def divergence(g: I64) -> I64:
    """Of the doubled gradient at the half-way points: Q11."""
    out = np.zeros(g.shape[:2], np.int64)
    half_x = g[:, 1:, 0] + g[:, :-1, 0]
    half_y = g[1:, :, 1] + g[:-1, :, 1]
    out[:, :-1] += half_x
    out[:, 1:] -= half_x
    out[:-1] += half_y
    out[1:] -= half_y
    return out


def _odd_cosines(n: int) -> I64:
    k, i = np.mgrid[: n // 2, : n // 2].astype(np.int64)
    return cos_pi_q30((2 * k + 1) * (2 * i + 1), 2 * n)


def _base_cosines(n: int) -> I64:
    k, i = np.mgrid[:n, :n].astype(np.int64)
    return cos_pi_q30(k * (2 * i + 1), 2 * n)


def forward_transform(x: I64) -> I64:
    """X_k = sum_i x_i cos(pi k (2 i + 1) / (2 n)) of each row, odd halves split off and rounded."""
    n = x.shape[1]
    if n % 2:
        return round_shift(x @ _base_cosines(n).T, 30)
    mirrored = x[:, ::-1]
    out = np.zeros_like(x)
    out[:, 1::2] = round_shift((x - mirrored)[:, : n // 2] @ _odd_cosines(n).T, 30)
    out[:, 0::2] = forward_transform((x + mirrored)[:, : n // 2])
    return out


def inverse_transform(a: I64) -> I64:
    """x_i = sum_k a_k cos(pi k (2 i + 1) / (2 n)) of each row, with coefficients in Q27."""
    n = a.shape[1]
    if n % 2:
        return round_shift(a @ (_base_cosines(n) >> 3), 27)
    odd = round_shift(a[:, 1::2] @ (_odd_cosines(n) >> 3), 27)
    even = inverse_transform(a[:, 0::2])
    return np.concatenate([even + odd, (even - odd)[:, ::-1]], axis=1)


def solve_columns(f: I64, saturations: Saturations) -> I64:
    """Tridiagonal solve along y for every wave number k; f is the transformed divergence."""
    n_y, n_x = f.shape
    one = 1 << 30
    eigenvalue = 2 * (one - cos_pi_q30(np.arange(1, n_x, dtype=np.int64), n_x))
    z = np.zeros_like(f)
    # k = 0: height is the double sum of the flux.
    flux = np.cumsum(f[:, 0])
    z[1:, 0] = np.cumsum(flux)[:-1]
    z[:, 0] = saturations.int32(z[:, 0])
    factor = np.zeros((n_y, n_x - 1), np.int64)
    above = np.zeros(n_x - 1, np.int64)
    for y in range(n_y):
        total = saturations.int32(above - f[y, 1:])
        diagonal = (1 if y in (0, n_y - 1) else 2) * one + eigenvalue
        pivot = diagonal - (factor[y - 1] if y else 0)
        if y + 1 < n_y:
            factor[y] = (1 << 60) // pivot
            above = round_shift(total * factor[y], 30)
        else:
            above = saturations.int32((total * one + pivot // 2) // pivot)
        z[y, 1:] = above
    for y in range(n_y - 2, -1, -1):
        z[y, 1:] = saturations.int32(z[y, 1:] + round_shift(z[y + 1, 1:] * factor[y], 30))
    return z


def gauge_cells(board: Board) -> I64:
    """Flat indices of the cells over which the mean depth is zero."""
    n_y, n_x = depth_grid(board)
    window, standoff = board["window"], board["camera"]["standoff_um"]
    x = (ray_slopes(board, "x", n_x) * standoff >> 16) + board["pad"]["size_x_um"] // 2
    y = (ray_slopes(board, "y", n_y) * standoff >> 16) + board["pad"]["size_y_um"] // 2
    inside_x = np.minimum(x - window["min_x_um"], window["max_x_um"] - x)[None, :]
    inside_y = np.minimum(y - window["min_y_um"], window["max_y_um"] - y)[:, None]
    inside = np.minimum(inside_x, inside_y)
    chosen = inside >= 0
    if board["depth"]["gauge"] == "margin":
        chosen &= inside < board["depth"]["margin_um"]
    cells = np.flatnonzero(chosen)
    return cells if len(cells) else np.arange(n_x * n_y)


def poisson(board: Board, slope: I64, saturations: Saturations) -> I64:
    """Depth, 1/8 micrometre."""
    n_x = slope.shape[1]
    f = divergence(gradient(board, slope, saturations))
    z = solve_columns(forward_transform(f), saturations)
    weight = np.where(np.arange(n_x) == 0, 8, 16)
    waves = saturations.clamp((z * weight + n_x) // (2 * n_x), -(1 << 26), 1 << 26)
    w = round_shift(inverse_transform(waves), 2)
    cells = gauge_cells(board)
    w = saturations.clamp(w - int(w.ravel()[cells].sum()) // len(cells), -(1 << 24), 1 << 24)
    standoff = board["camera"]["standoff_um"]
    second = round_shift(round_shift(w * w, 11) * ((1 << 40) // (2 * standoff)), 40)
    third = round_shift(round_shift(second * w, 11) * ((1 << 40) // (3 * standoff)), 40)
    return saturations.int16(round_shift(w + second + third, 8))
