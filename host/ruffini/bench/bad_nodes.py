"""Nodes that are wrong or missing: their cost with the board's repair, without it, with a median test. SIMULATED.

The board repairs the nodes that `Pipeline.solve` takes (firmware/image/field_repair.h). The peers are the same second
pass in float64: on the nodes as they are, and behind the normalised median test of Westerweel and Scarano (Experiments
in Fluids 39, 2005), which particle image velocimetry uses on such fields. A missing node is the mean of its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.bench.markers import fill_with_means

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

OFF_UM = 200.0
HOLE_MM = 3.0
MEDIAN_LIMIT = 2.0  # of the residual over the neighbours' own; the paper's
NOISE_M = (5e-6, 5e-6, 20e-6)  # of a node; the paper adds 0.1 px to the neighbours' residual


@dataclass(frozen=True)
class BadNodes:
    """White noise (x, y, z, micrometres); a share of the nodes off along the surface, a round hole missing (NaN)."""

    white_um: tuple[float, float, float]
    share: float = 0.0
    hole_mm: float = 0.0

    def observe(self, displacement: Array, step_mm: tuple[float, float], rng: np.random.Generator) -> Array:
        """What is measured of a true displacement (n_y, n_x, 3), m; the hole is about a node that is pressed in."""
        shape = displacement.shape[:2]
        u = displacement + rng.normal(size=displacement.shape) * np.array(self.white_um) * 1e-6
        wrong = rng.permutation(shape[0] * shape[1])[: round(self.share * shape[0] * shape[1])]
        turn = rng.uniform(0, 2 * np.pi, len(wrong))
        u[wrong // shape[1], wrong % shape[1], :2] += OFF_UM * 1e-6 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        pressed = np.argwhere(displacement[..., 2] < displacement[..., 2].min() / 2)
        row, column = pressed[rng.integers(len(pressed))]
        y, x = np.mgrid[: shape[0], : shape[1]]
        away_mm = np.hypot((x - column) * step_mm[0], (y - row) * step_mm[1])
        u[away_mm < self.hole_mm / 2] = np.nan
        return np.asarray(u)


def without_holes(u: Array) -> Array:
    """Missing nodes as the mean of their neighbours, ring by ring."""
    is_missing = np.asarray(np.isnan(u).any(axis=-1))
    return fill_with_means(u, is_missing)


def median_tested(u: Array) -> Array:
    """Nodes that fail the normalised median test take the median of their neighbours, each component for itself."""
    out = without_holes(u)
    around = np.stack(_neighbours(out))
    median = np.nanmedian(around, axis=0)
    own = np.nanmedian(np.abs(around - median), axis=0) + np.array(NOISE_M)
    return np.where(np.abs(out - median) > MEDIAN_LIMIT * own, median, out)


def _neighbours(u: Array) -> list[Array]:
    """The eight neighbours of each node, NaN beyond the border."""
    n_y, n_x, _ = u.shape
    wide = np.pad(u, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    places = [(v, w) for v in range(3) for w in range(3) if (v, w) != (1, 1)]
    return [wide[v : v + n_y, w : w + n_x] for v, w in places]


def peers(second_pass: Callable[[Array], Array]) -> dict[str, Callable[[Array], Array]]:
    """The second pass on what each peer makes of the nodes; `second_pass` takes (n_y, n_x, 3) m without NaN."""
    return {
        "not repaired": lambda u: second_pass(without_holes(u)),
        "median test": lambda u: second_pass(median_tested(u)),
    }
