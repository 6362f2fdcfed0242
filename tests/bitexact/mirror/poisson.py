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


def inverse_table() -> I64:
    """1 / x, Q24, of x in Q14 at every 64th; held below 1/16."""
    x = np.maximum(np.arange(514, dtype=np.int64) << 6, 1 << 10)
    return np.asarray(((1 << 39) + x) // (2 * x))


def gradient(board: Board, slope: I64, saturations: Saturations) -> I64:
    """(n_y, n_x, 2), micrometres per cell, Q10."""
    n_y, n_x = slope.shape[:2]
    camera = board["camera"]
    cell_q10 = min(camera["standoff_um"] * board["depth"]["step_px"] * 1024 * 1000 // camera["focal_mpx"], 8191 << 10)
    ray_x, ray_y = ray_slopes(board, "x", n_x)[None, :], ray_slopes(board, "y", n_y)[:, None]
    fold = np.clip(round_shift(slope[..., 0] * ray_x + slope[..., 1] * ray_y, 14), -ONE_Q14, MAX_FOLD)
    line, fraction = (ONE_Q14 - fold) >> 6, (ONE_Q14 - fold) & 63
    table = inverse_table()
    inverse = table[line] + round_shift((table[line + 1] - table[line]) * fraction, 6)
    scale = round_shift(inverse * cell_q10, 20)
    return saturations.clamp(round_shift(slope * scale[..., None], 16), -(1 << 20), 1 << 20)


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


def _ii(n: int) -> I64:
    k, i = np.mgrid[:n, :n].astype(np.int64)
    return cos_pi_q30(k * (2 * i + 1), 2 * n)


def _iv(n: int) -> I64:
    k, i = np.mgrid[:n, :n].astype(np.int64)
    return cos_pi_q30((2 * k + 1) * (2 * i + 1), 4 * n)


def type_ii(x: I64) -> I64:
    """X_k = sum_i x_i cos(pi k (2 i + 1) / (2 n)) of each row."""
    n = x.shape[1]
    if n % 2:
        return round_shift(x @ _ii(n).T, 30)
    left, right = x[:, : n // 2], x[:, : n // 2 - 1 : -1]
    out = np.zeros_like(x)
    out[:, 0::2] = type_ii(left + right)
    out[:, 1::2] = type_iv(left - right)
    return out


def type_iii(x: I64) -> I64:
    """x_i = sum_k X_k cos(pi k (2 i + 1) / (2 n)) of each row."""
    n = x.shape[1]
    if n % 2:
        return round_shift(x @ _ii(n), 30)
    even, odd = type_iii(x[:, 0::2]), type_iv(x[:, 1::2])
    return np.concatenate([even + odd, (even - odd)[:, ::-1]], axis=1)


def type_iv(x: I64) -> I64:
    """X_k = sum_i x_i cos(pi (2 k + 1)(2 i + 1) / (4 m)) of each row: rotations, then two of type II."""
    m = x.shape[1]
    if m % 2:
        return round_shift(x @ _iv(m).T, 30)
    half = m // 2
    angle = 2 * np.arange(half, dtype=np.int64) + 1
    c, s = cos_pi_q30(angle, 4 * m), cos_pi_q30(2 * m - angle, 4 * m)
    sign = 1 - 2 * (np.arange(half) % 2)
    a, b = x[:, :half], x[:, : half - 1 : -1]
    u = type_ii(round_shift(a * c + b * s, 30))
    w = type_ii(round_shift(sign * (b * c - a * s), 30))
    out = np.zeros_like(x)
    out[:, 0] = u[:, 0]
    out[:, 2::2] = u[:, 1:] + w[:, :0:-1]
    out[:, 1:-1:2] = u[:, 1:] - w[:, :0:-1]
    out[:, -1] = -w[:, 0]
    return out


MAX_WAVE = 1 << 29
MAX_UP = 16


def scaled(x: I64, up: int) -> I64:
    """x 2^up, half up."""
    return x << up if up >= 0 else round_shift(x, -up)


def transform_rows(f: I64) -> I64:
    """Q8, from f in Q11."""
    n = f.shape[1]
    up = min(30 - int((int(np.abs(f).max()) + 1) * n).bit_length(), MAX_UP)
    return scaled(type_ii(scaled(f, up)), -3 - up)


def invert_rows(z: I64) -> I64:
    """w in Q8, from waves times n / 2."""
    n = z.shape[1]
    up = min(29 - int(np.abs(z).max()).bit_length(), MAX_UP)
    products = z * ((2 << 30) // n)
    v = round_shift(products, 30 - up)
    v[:, 0] = round_shift(products[:, 0], 31 - up)
    return scaled(type_iii(v), -up)


def solve_columns(f: I64, saturations: Saturations) -> I64:
    """Tridiagonal solve along y for every wave number k; f is the transformed divergence."""
    n_y, n_x = f.shape
    one = 1 << 30
    eigenvalue = 2 * (one - cos_pi_q30(np.arange(1, n_x, dtype=np.int64), n_x))
    z = np.zeros_like(f)

    def held(x: I64) -> I64:
        return saturations.clamp(x, -MAX_WAVE, MAX_WAVE)

    # k = 0: height is the double sum of the flux.
    flux = np.cumsum(f[:, 0])
    z[1:, 0] = np.cumsum(flux)[:-1]
    z[:, 0] = held(z[:, 0])
    factor = np.zeros((n_y, n_x - 1), np.int64)
    above = np.zeros(n_x - 1, np.int64)
    for y in range(n_y):
        total = held(above - f[y, 1:])
        diagonal = (1 if y in (0, n_y - 1) else 2) * one + eigenvalue
        pivot = diagonal - (factor[y - 1] if y else 0)
        if y + 1 < n_y:
            factor[y] = (1 << 60) // pivot
            above = round_shift(total * factor[y], 30)
        else:
            above = held((total * one + pivot // 2) // pivot)
        z[y, 1:] = above
    for y in range(n_y - 2, -1, -1):
        z[y, 1:] = held(z[y, 1:] + round_shift(z[y + 1, 1:] * factor[y], 30))
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
    f = divergence(gradient(board, slope, saturations))
    w = invert_rows(solve_columns(transform_rows(f), saturations))
    cells = gauge_cells(board)
    mean = int(w.ravel()[cells].sum()) // len(cells)
    w = saturations.clamp(np.clip(w, -(1 << 29), 1 << 29) - np.clip(mean, -(1 << 29), 1 << 29), -(1 << 21), 1 << 21)
    standoff = board["camera"]["standoff_um"]
    third = round_shift(w * ((1 << 36) // (3 * standoff)), 20) + (1 << 24)
    second = round_shift(round_shift(w * ((1 << 36) // (2 * standoff)), 20) * third, 24)
    return saturations.int16(round_shift(w * (second + (1 << 24)), 29))
