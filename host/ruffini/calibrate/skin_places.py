"""Where a touch is between the taxels of a glowing skin, how far it reaches, how sure that is; see `skin_response`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.calibrate.skin_presses import Press
from ruffini.calibrate.skin_response import FORCE_N, KINDS, PLACED_N, ForceFit, Layout, peaks, sinks

Array = npt.NDArray[np.float64]

PLACE_RIDGE = 0.01
REACH_STEP_MM = 2.5
REACH_SIZE = (11, 49)  # offsets along x and y: 25 and 120 mm
REACH_LEAST = 0.002  # of u at the touch, all over the table: so far a touch keeps fainter ones from being seen
SMOOTH = 0.3
APART_MARGIN = 1.2  # over what a single touch leaves unexplained
APART_LEAST = 0.15
BEYOND = 3  # a touch beyond the table may be fainter by that (firmware/estimators/taxel_touches.h)


@dataclass(frozen=True)
class PlaceFit:
    """Taxels' places as this skin has them (n, 2) mm, and cubics in q of each taxel, (n, 2, 4) mm."""

    places_mm: Array
    shift_mm: Array

    def place(self, u: Array, layout: Layout) -> Array:
        """Places (t, 2) mm of one touch a frame."""
        at = peaks(u, layout)
        powers = at.q[..., None] ** np.arange(4)
        return np.asarray(self.places_mm[at.taxel] + (powers * self.shift_mm[at.taxel]).sum(axis=2))


def fit_places(presses: list[Press], layout: Layout) -> PlaceFit:
    """Linear least squares: the lattice's shift and turn, and a cubic for each kind of column and of row.

    A kind at a rim has one neighbour, and q its part of u: another cubic than q by two.
    """
    rows, wanted, weights = [], [], []
    for press in presses:
        u = sinks(press)
        at = peaks(u, layout)
        away = layout.away(press.place_mm)[at.taxel]
        for frame in np.flatnonzero(press.force_n > PLACED_N):
            taxel = at.taxel[frame]
            for axis in (0, 1):
                rows.append(_row(layout, taxel, axis, at.q[frame, axis]))
                wanted.append(away[frame, axis])
                weights.append(min(press.force_n[frame], 4.0) ** 0.5)
    a, b, w = np.array(rows), np.array(wanted), np.array(weights)
    ridge = PLACE_RIDGE * len(b) ** 0.5 * np.eye(a.shape[1])
    values, *_ = np.linalg.lstsq(np.vstack([a * w[:, None], ridge]), np.append(b * w, np.zeros(len(ridge))), rcond=None)
    n = len(layout.places_mm)
    moved = np.column_stack([-layout.places_mm[:, 1], layout.places_mm[:, 0]]) * values[2] + values[:2]
    cubics = values[3:].reshape(2, KINDS, 2, 4)
    shift = np.zeros((n, 2, 4))
    for axis in (0, 1):
        sign = layout.sign[:, axis, None] ** (np.arange(4) + 1)
        rim = _is_rim(layout, axis)
        own = cubics[axis, layout.kind[:, axis], rim.astype(int)]
        # At a rim q has no sign of its own: the whole cubic turns with the side.
        shift[:, axis] = np.where(rim[:, None], own * layout.sign[:, axis, None], own * sign)
    return PlaceFit(layout.places_mm + moved, shift)


def _is_rim(layout: Layout, axis: int) -> npt.NDArray[np.bool_]:
    return np.asarray((layout.near[:, 2 * axis] < 0) | (layout.near[:, 2 * axis + 1] < 0))


def _row(layout: Layout, taxel: int, axis: int, q: float) -> Array:
    """Columns: shift x, y, turn, then cubics by axis, kind and rim."""
    row = np.zeros(3 + 2 * KINDS * 2 * 4)
    row[axis] = 1
    row[2] = -layout.places_mm[taxel, 1] if axis == 0 else layout.places_mm[taxel, 0]
    rim, sign = bool(_is_rim(layout, axis)[taxel]), layout.sign[taxel, axis]
    powers = q ** np.arange(4)
    at = 3 + ((axis * KINDS + layout.kind[taxel, axis]) * 2 + int(rim)) * 4
    row[at : at + 4] = powers * sign if rim else powers * sign ** (np.arange(4) + 1)
    return row


def fit_reach(presses: list[Press], layout: Layout, places: PlaceFit) -> Array:
    """u at offsets (|x|, |y|) from a touch over u at it, (rows, columns) in steps of REACH_STEP_MM, 1 at the touch."""
    n_x, n_y = REACH_SIZE
    total, weight = np.zeros((n_y, n_x)), np.zeros((n_y, n_x))
    for press in presses:
        u = sinks(press)
        off = np.abs(layout.away(press.place_mm)) / REACH_STEP_MM
        cell = np.round(off).astype(int)
        inside = (cell[:, 0] < n_x) & (cell[:, 1] < n_y)
        near = np.linalg.norm(off * REACH_STEP_MM, axis=1)
        for frame in np.flatnonzero((press.force_n > FORCE_N[0]) & (press.force_n < FORCE_N[1])):
            # Strength: what the nearest taxel has, brought to the touch by the cusp that rubber under a sheet shows.
            taxel = int(near.argmin())
            strength = max(u[frame, taxel] * np.exp(near[taxel] / 20.0), 1e-3)
            np.add.at(total, (cell[inside, 1], cell[inside, 0]), np.maximum(u[frame, inside], 0) / strength)
            np.add.at(weight, (cell[inside, 1], cell[inside, 0]), 1.0)
    table = _filled(total, weight)
    table[0, 0] = 1.0
    table = np.minimum.accumulate(np.minimum.accumulate(table, axis=0), axis=1)
    return np.asarray(np.maximum(table, REACH_LEAST))


def _filled(total: Array, weight: Array) -> Array:
    """Means where there are any, smooth between: second differences are held small."""
    value = np.where(weight > 0, total / np.maximum(weight, 1), 0.0)
    trust = weight / (weight + 5)
    out = value.copy()
    for _ in range(400):
        padded = np.pad(out, 1, mode="reflect")
        mean = (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 4
        out = (trust * value + SMOOTH * mean) / (trust + SMOOTH)
    return out


def reach_at(table: Array, off_mm: Array) -> Array:
    """Reach (n,) at offsets (n, 2), bilinear, 0 beyond the table."""
    at = np.abs(off_mm) / REACH_STEP_MM
    column, row = (np.floor(at[:, axis]).astype(int) for axis in (0, 1))
    inside = (column <= table.shape[1] - 2) & (row <= table.shape[0] - 2)
    c, r = np.where(inside, column, 0), np.where(inside, row, 0)
    fx, fy = at[:, 0] - column, at[:, 1] - row
    top = table[r, c] * (1 - fx) + table[r, c + 1] * fx
    bottom = table[r + 1, c] * (1 - fx) + table[r + 1, c + 1] * fx
    return np.asarray(np.where(inside, top * (1 - fy) + bottom * fy, 0.0))


def unexplained(presses: list[Press], layout: Layout, places: PlaceFit, table: Array) -> float:
    """What single touches leave at most, over a taxel's own sink and the touch's strength, or part of it (99.5 %)."""
    most = []
    for press in presses:
        u = sinks(press)
        found = places.place(u, layout)
        at = peaks(u, layout)
        for frame in np.flatnonzero((press.force_n > FORCE_N[0]) & (press.force_n < FORCE_N[1])):
            reach = reach_at(table, _moved(layout, places).away(found[frame]))
            strength = at.u[frame] / max(reach[at.taxel[frame]], 1 / 16)
            left = u[frame] - strength * reach
            against = np.maximum(u[frame], np.where(reach > 0, strength, strength / BEYOND))
            touched = u[frame] > 0.05
            most.append(float((left / np.maximum(against, 1e-6))[touched].max()))
    return float(np.quantile(most, 0.995))


def _moved(layout: Layout, places: PlaceFit) -> Layout:
    return Layout(places.places_mm, layout.near, layout.kind, layout.sign, layout.round_mm)


def errors(presses: list[Press], layout: Layout, force: ForceFit, places: PlaceFit) -> tuple[Array, Array, Array]:
    """Reference force (N), error of the force (N) and of the place (mm) of every pressed frame within FORCE_N."""
    out: list[tuple[float, float, float]] = []
    moved = _moved(layout, places)
    for press in presses:
        u = sinks(press)
        estimate, found = force.force(press, layout), places.place(u, layout)
        taxel = int(np.linalg.norm(moved.away(press.place_mm), axis=1).argmin())
        wanted = moved.places_mm[taxel] + moved.away(press.place_mm)[taxel]
        off = found - wanted
        if layout.round_mm:
            off[:, 0] = (off[:, 0] + layout.round_mm / 2) % layout.round_mm - layout.round_mm / 2
        for frame in np.flatnonzero((press.force_n > PLACED_N) & (press.force_n < FORCE_N[1])):
            error = estimate[frame] - press.force_n[frame]
            out.append((press.force_n[frame], float(error), float(np.linalg.norm(off[frame]))))
    rows = np.array(out).reshape(-1, 3)
    return rows[:, 0], rows[:, 1], rows[:, 2]
