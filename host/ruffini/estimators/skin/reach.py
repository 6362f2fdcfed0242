"""How far a touch reaches over the taxels of a glowing skin, and what it leaves unexplained; see `skin_response`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from ruffini.estimators.skin.places import PlaceFit, moved
from ruffini.estimators.skin.presses import Press
from ruffini.estimators.skin.response import FORCE_N, Layout, peaks, sinks

Array = npt.NDArray[np.float64]
Sparse = Any  # scipy.sparse has no types

REACH_STEP_MM = 2.5
REACH_SIZE = (11, 49)  # offsets along x and y: 25 and 120 mm
REACH_LEAST = 0.002  # of u at the touch, all over the table: so far a touch keeps fainter ones from being seen
NOISE, PART = 0.02, 0.05  # of u that the table is trusted to: a constant, and a part of it
SMOOTH = 12.0  # weight of second differences, for each frame
ROUNDS = 6  # of strengths by the table and the table by strengths
START_MM = (9.0, 18.0)  # along x and y a touch falls off to 1 / e: where the rounds begin
APART_MARGIN = 1.0  # over what a single touch leaves unexplained, one frame of 200 excepted
APART_LEAST = 0.15
BEYOND = 3  # a touch beyond the table may be fainter by that (firmware/stages/skin/taxel_touches.h)
PEAK = 6  # of is_peak, there


def fit_reach(presses: list[Press], layout: Layout, places: PlaceFit) -> Array:
    """u at offsets (|x|, |y|) from a touch over u at it, (rows, columns) in steps of REACH_STEP_MM, 1 at the touch.

    Least squares: the strength of every frame, then the table, linear between its lines, smooth.
    """
    reference = moved(layout, places)
    seen: list[tuple[Sparse, Array, Array]] = []
    for press in presses:
        u = sinks(press)
        rows = _linear(np.abs(reference.away(press.place_mm)))
        for frame in np.flatnonzero((press.force_n > FORCE_N[0]) & (press.force_n < FORCE_N[1])):
            seen.append((rows, u[frame], 1 / np.hypot(NOISE, PART * u[frame])))
    x, y = np.meshgrid(*(np.arange(n) * REACH_STEP_MM for n in REACH_SIZE))
    table = np.exp(-x / START_MM[0] - y / START_MM[1]).ravel()
    smooth = SMOOTH * len(seen) * _bends()
    for _ in range(ROUNDS):
        normal, right = smooth + 1e-3 * sp.eye(table.size), np.zeros(table.size)
        for rows, u, weight in seen:
            shape = (rows @ table) * weight
            strength = max(float(shape @ (u * weight) / max(shape @ shape, 1e-9)), 0.05)
            scaled = rows.multiply((strength * weight)[:, None]).tocsr()
            normal = normal + scaled.T @ scaled
            right += scaled.T @ (u * weight)
        table = np.asarray(spsolve(sp.csc_matrix(normal), right))
        table = table / table[0]
    falls = np.minimum.accumulate(np.minimum.accumulate(table.reshape(x.shape), axis=0), axis=1)
    return np.asarray(np.maximum(falls, REACH_LEAST))


def _linear(off_mm: Array) -> Sparse:
    """Weights (n, lines) of the table's values at offsets (n, 2), none beyond it."""
    n_x, n_y = REACH_SIZE
    at = off_mm / REACH_STEP_MM
    inside = (at[:, 0] < n_x - 1) & (at[:, 1] < n_y - 1)
    line = np.where(inside[:, None], np.minimum(at.astype(int), [n_x - 2, n_y - 2]), 0)
    (fx, fy), (column, row) = (at - line).T, line.T
    pairs = [(0, 0, (1 - fx) * (1 - fy)), (1, 0, fx * (1 - fy)), (0, 1, (1 - fx) * fy), (1, 1, fx * fy)]
    number = np.arange(len(at))
    parts = [sp.csr_matrix((w * inside, (number, (row + dy) * n_x + column + dx)), (len(at), n_x * n_y))
             for dx, dy, w in pairs]  # fmt: skip
    return sp.csr_matrix(sum(parts[1:], parts[0]))


def _bends() -> Sparse:
    """Sum of the squares of second differences along both axes, as a matrix; the table goes on as its mirror image."""
    one = []
    for n in REACH_SIZE:
        second = sp.diags([1.0, -2.0, 1.0], [-1, 0, 1], (n, n)).tolil()
        second[0, 1] = 2.0
        one.append(sp.csr_matrix(second)[: n - 1])
    along_x, along_y = sp.kron(sp.eye(REACH_SIZE[1]), one[0]), sp.kron(one[1], sp.eye(REACH_SIZE[0]))
    return sp.csr_matrix(along_x.T @ along_x + along_y.T @ along_y)


def reach_at(table: Array, off_mm: Array) -> Array:
    """Reach (...) at offsets (..., 2), linear between, 0 beyond the table."""
    n_x, n_y = REACH_SIZE
    at = np.abs(off_mm) / REACH_STEP_MM
    line = np.minimum(at.astype(int), [n_x - 2, n_y - 2])
    (column, row), (right, below) = np.moveaxis(line, -1, 0), np.moveaxis(at - line, -1, 0)
    above = table[row, column] * (1 - right) + table[row, column + 1] * right
    behind = table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right
    is_inside = (at[..., 0] < n_x - 1) & (at[..., 1] < n_y - 1)
    return np.asarray(np.where(is_inside, above * (1 - below) + behind * below, 0.0))


def unexplained(presses: list[Press], layout: Layout, places: PlaceFit, table: Array) -> float:
    """What single touches leave at most, over a taxel's own sink and the touch's strength, or part of it (99.5 %)."""
    most, own = [], moved(layout, places)
    for press in presses:
        u = sinks(press)
        found, at = places.place(u, layout), peaks(u, layout)
        for frame in np.flatnonzero((press.force_n > FORCE_N[0]) & (press.force_n < FORCE_N[1])):
            reach = reach_at(table, own.away(found[frame]))
            strength = at.u[frame] / max(reach[at.taxel[frame]], 1 / 16)
            left = u[frame] - strength * reach
            against = np.maximum(u[frame], np.where(reach > 0, strength, strength / BEYOND))
            touched = (u[frame] > 0.05) & stands_out(u[frame], layout)
            most.append(float((left / np.maximum(against, 1e-6))[touched].max(initial=0.0)))
    return float(np.quantile(most, 0.995))


def stands_out(u: Array, layout: Layout) -> npt.NDArray[np.bool_]:
    """Taxels (n,) that can be another touch: 2 u - u_a - u_b over u / PEAK along both axes, as the firmware asks."""
    out = np.ones(len(u), dtype=bool)
    for axis in (0, 1):
        a, b = layout.near[:, 2 * axis], layout.near[:, 2 * axis + 1]
        a, b = np.where(a < 0, b, a), np.where(b < 0, a, b)
        two = np.where(a >= 0, u[a] + u[b], 0.0)
        out &= 2 * u - two >= u / PEAK
    return out
