"""How much better two places explain a single touch of a glowing skin than one: firmware/stages/skin/touch_pair.h.

The firmware tells two fingers where that is more than of any single touch of the fit. In float.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
import numpy.typing as npt

from ruffini.estimators.skin.places import PlaceFit, moved
from ruffini.estimators.skin.presses import Press
from ruffini.estimators.skin.reach import REACH_STEP_MM, reach_at
from ruffini.estimators.skin.response import FORCE_N, Layout, sinks

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.intp]

ROWS, COLUMNS = 7, 5
NOISE, PART = 0.02, 0.05
GRID = 2 * np.arange(-3, 4) * REACH_STEP_MM
FINER_MM = (REACH_STEP_MM, REACH_STEP_MM, REACH_STEP_MM / 2, REACH_STEP_MM / 2, REACH_STEP_MM / 4, REACH_STEP_MM / 4)
AROUND = np.array(list(product((-1, 0, 1), repeat=2)), dtype=float)
NEAR_MM, FAR_MM = 4 * REACH_STEP_MM, 8 * REACH_STEP_MM
ON_TAXEL_MM = 2.5 * REACH_STEP_MM  # half a pitch and a little: nearer to a taxel, or beside the skin
FAR_AWAY_MM = 1e3
EVEN, LEAST, SLACK = 1.6, 0.05, 3.0
LEAST_TURN = 1 / 1024


@dataclass(frozen=True)
class Patch:
    """Taxels about one: their numbers by rows (ROWS, COLUMNS) or -1, and where they are from it (mm)."""

    node: Numbers
    place_mm: Array
    table: Array

    def described(self, value: Array, weight: Array) -> Array:
        """Sinks and bends (..., 2 k) of values (..., ROWS, COLUMNS)."""
        is_there = self.node >= 0
        above, here, below = (value[..., i : i + ROWS - 2, :] for i in (0, 1, 2))
        has_above, has_below = is_there[:-2], is_there[2:]
        up = np.where(has_above, above, np.where(has_below, below, here))
        down = np.where(has_below, below, np.where(has_above, above, here))
        both = np.stack([here, 2 * here - up - down], axis=-3) * weight / 2
        return np.asarray(both.reshape(*value.shape[:-2], -1))

    def made(self, place_mm: Array, weight: Array) -> Array:
        """What touches one unit strong at places (m, 2) make, (m, 2 k)."""
        off = np.where(self.node[..., None] >= 0, self.place_mm - place_mm[:, None, None], FAR_AWAY_MM)
        is_on_skin = (np.abs(off).max(axis=-1) <= ON_TAXEL_MM).any(axis=(1, 2))[:, None, None]
        return self.described(reach_at(self.table, off) * is_on_skin, weight)


def patch_about(taxel: int, layout: Layout, table: Array) -> Patch:
    """The patch of a taxel; `layout` with the taxels where this skin has them."""

    def walk(start: int, way: int, steps: int) -> int:
        for _ in range(steps):
            start = int(layout.near[start, way]) if start >= 0 else -1
        return start

    node = np.full((ROWS, COLUMNS), -1)
    for row, column in product(range(ROWS), range(COLUMNS)):
        up, aside = row - ROWS // 2, column - COLUMNS // 2
        node[row, column] = walk(walk(taxel, 2 if up < 0 else 3, abs(up)), 0 if aside < 0 else 1, abs(aside))
    return Patch(node, -layout.away(layout.places_mm[taxel])[node], table)


def excess(u: Array, patch: Patch) -> float:
    """(J_1 - J_2) SLACK / (J_2 + SLACK n) of sinks u (n,) about their largest; 0 where no two places are better."""
    value = np.where(patch.node >= 0, u[patch.node], 0.0)
    middle = patch.node[1:-1]
    weight = np.where(middle >= 0, 1 / np.hypot(NOISE, PART * np.maximum(value[1:-1], 0)), 0.0)
    seen = patch.described(value, weight)
    slack, all_ = SLACK * float((middle >= 0).sum()), float(seen @ seen)
    x, y = np.meshgrid(GRID, GRID)
    grid = np.column_stack([x.ravel(), y.ravel()])

    def search(gain_at: Callable[[list[Array]], Array], n: int) -> float:
        """Largest gain of n places: on the grid, then around the best."""
        gain = gain_at([grid] * n)
        best, at = float(gain.max()), [grid[i] for i in np.unravel_index(int(gain.argmax()), gain.shape)]
        for step in FINER_MM if best > 0 else ():
            places = [place + AROUND * step for place in at]
            gain = gain_at(places)
            if gain.max() > best:
                best = float(gain.max())
                at = [p[i] for p, i in zip(places, np.unravel_index(int(gain.argmax()), gain.shape), strict=True)]
        return best

    def one(places: list[Array]) -> Array:
        made = patch.made(places[0], weight)
        return np.asarray(np.maximum(made @ seen, 0) ** 2 / np.maximum((made**2).sum(axis=1), 1e-9))

    def two(places: list[Array]) -> Array:
        a, b = (patch.made(p, weight) for p in places)
        return _gain_of_pairs(a, b, seen, np.linalg.norm(places[0][:, None] - places[1][None], axis=2))

    left = all_ - search(one, 1)
    if left <= 0:
        return 0.0
    left_by_two = all_ - search(two, 2)
    return max((left - left_by_two) * SLACK / (left_by_two + slack), 0.0)


def _gain_of_pairs(a: Array, b: Array, seen: Array, apart_mm: Array) -> Array:
    """By how much two touches at once lessen the sum of squares, (m, k); 0 where they cannot be two."""
    own_a, own_b, both = (a**2).sum(axis=1)[:, None], (b**2).sum(axis=1)[None], a @ b.T
    with_a, with_b = (a @ seen)[:, None], (b @ seen)[None]
    turn = own_a * own_b - both**2
    is_turned = turn > LEAST_TURN * own_a * own_b
    safe = np.where(is_turned, turn, 1.0)
    first, second = (with_a * own_b - with_b * both) / safe, (with_b * own_a - with_a * both) / safe
    is_pair = is_turned & (apart_mm >= NEAR_MM - 1e-9) & (apart_mm <= FAR_MM + 1e-9)
    is_pair &= (np.minimum(first, second) >= LEAST) & (np.maximum(first, second) <= EVEN * np.minimum(first, second))
    return np.asarray(np.where(is_pair, first * with_a + second * with_b, 0.0))


def most_excess(presses: list[Press], layout: Layout, places: PlaceFit, table: Array) -> float:
    """The largest excess of any frame of single touches within FORCE_N."""
    own = moved(layout, places)
    about = cache(lambda taxel: patch_about(taxel, own, table))
    most = 0.0
    for press in presses:
        u = sinks(press)
        for frame in np.flatnonzero((press.force_n > FORCE_N[0]) & (press.force_n < FORCE_N[1])):
            most = max(most, excess(u[frame], about(int(u[frame].argmax()))))
    return most
