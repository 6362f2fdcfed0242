"""Where a touch is between the taxels of a glowing skin, how sure that is; see `skin_response`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.estimators.skin.presses import Press
from ruffini.estimators.skin.response import (
    FORCE_N,
    KINDS,
    PLACED_N,
    ForceFit,
    Layout,
    gain_kinds,
    peaks,
    rims,
    sinks,
)
from ruffini.estimators.skin.spread import Errors

Array = npt.NDArray[np.float64]

PLACE_RIDGE = 0.01


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
        rim = rims(layout, axis)
        own = cubics[axis, layout.kind[:, axis], rim.astype(int)]
        # At a rim q has no sign of its own: the whole cubic turns with the side.
        shift[:, axis] = np.where(rim[:, None], own * layout.sign[:, axis, None], own * sign)
    return PlaceFit(layout.places_mm + moved, shift)


def _row(layout: Layout, taxel: int, axis: int, q: float) -> Array:
    """Columns: shift x, y, turn, then cubics by axis, kind and rim."""
    row = np.zeros(3 + 2 * KINDS * 2 * 4)
    row[axis] = 1
    row[2] = -layout.places_mm[taxel, 1] if axis == 0 else layout.places_mm[taxel, 0]
    rim, sign = bool(rims(layout, axis)[taxel]), layout.sign[taxel, axis]
    powers = q ** np.arange(4)
    at = 3 + ((axis * KINDS + layout.kind[taxel, axis]) * 2 + int(rim)) * 4
    row[at : at + 4] = powers * sign if rim else powers * sign ** (np.arange(4) + 1)
    return row


def moved(layout: Layout, places: PlaceFit) -> Layout:
    """The layout with the taxels where this skin has them."""
    return Layout(places.places_mm, layout.near, layout.kind, layout.sign, layout.round_mm)


def errors(presses: list[Press], layout: Layout, force: ForceFit, places: PlaceFit) -> Errors:
    """Of every pressed frame within FORCE_N; `press` numbers `presses`."""
    parts: list[Errors] = []
    own, kinds = moved(layout, places), gain_kinds(layout)
    for number, press in enumerate(presses):
        u = sinks(press)
        estimate, found = force.force(press, layout), places.place(u, layout)
        taxel = int(np.linalg.norm(own.away(press.place_mm), axis=1).argmin())
        wanted = own.places_mm[taxel] + own.away(press.place_mm)[taxel]
        off = found - wanted
        if layout.round_mm:
            off[:, 0] = (off[:, 0] + layout.round_mm / 2) % layout.round_mm - layout.round_mm / 2
        rows = (press.force_n > PLACED_N) & (press.force_n < FORCE_N[1])
        kind = kinds[peaks(u, layout).taxel]
        every = Errors(press.force_n, estimate - press.force_n, off, kind, np.full(len(rows), number))
        parts.append(every.of(rows))
    return Errors.joined(parts)
