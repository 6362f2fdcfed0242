"""Markers as the board uses them: lost ones are filled smoothly, nodes interpolate over the lattice.

The float twin of the filling in firmware/image/field_repair.h; the bit-exact tests hold it to the core within rounding.
The nodes: `ruffini.estimators.operator.marker_lattice`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

from ruffini.estimators.operator.marker_lattice import NodesOnLattice

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


SWEEPS, MOST_PLATE_PART = 24, 4  # kSweeps, kMaxMissingPart of firmware/image/field_repair.h


def fill_lost(u: Array, is_lost: Bools) -> Array:
    """The lost markers' displacement, continued smoothly from the known ones; u (n_y, n_x, k).

    Ring by ring the mean of the up to eight known neighbours, then the thin plate's equation by Gauss-Seidel.
    """
    out = fill_with_means(u, is_lost)
    n_y, n_x = is_lost.shape
    if MOST_PLATE_PART * int(is_lost.sum()) > is_lost.size:
        return out
    inside = [(y, x) for y, x in np.argwhere(is_lost) if 2 <= y < n_y - 2 and 2 <= x < n_x - 2]
    for _ in range(SWEEPS):
        for y, x in inside:
            beside = out[y, x + 1] + out[y, x - 1] + out[y + 1, x] + out[y - 1, x]
            diagonal = out[y + 1, x + 1] + out[y - 1, x + 1] + out[y + 1, x - 1] + out[y - 1, x - 1]
            far = out[y, x + 2] + out[y, x - 2] + out[y + 2, x] + out[y - 2, x]
            out[y, x] = (8 * beside - 2 * diagonal - far) / 20
    return out


def fill_with_means(u: Array, is_lost: Bools) -> Array:
    """Ring by ring, each lost marker is the mean of its up to eight known neighbours; u (n_y, n_x, k)."""
    out = np.where(is_lost[..., None], 0.0, u)
    known = ~is_lost
    while known.any() and not known.all():
        count = 9 * uniform_filter(known.astype(float), 3, mode="constant")
        total = 9 * uniform_filter(out, (3, 3, 1), mode="constant")
        reached = ~known & (count > 0.5)
        out[reached] = total[reached] / np.round(count[reached])[:, None]
        known = known | reached
    return out


@dataclass(frozen=True)
class LostMarkers:
    """Shear observed at markers, of which a share is lost; depth at the nodes. White noise, micrometres (x, y, z)."""

    share: float
    white_um: tuple[float, float, float]

    def observe(
        self, lattice: NodesOnLattice, displacement: Array, at_markers: Array, rng: np.random.Generator
    ) -> Array:
        """The displacement (n_y, n_x, 3) that the board makes of a true one at its nodes and at its markers."""
        noise = np.array(self.white_um) * 1e-6
        seen = at_markers[..., :2] + rng.normal(size=(*at_markers.shape[:2], 2)) * noise[:2]
        depth = displacement[..., 2] + rng.normal(size=displacement.shape[:2]) * noise[2]
        n = seen.shape[0] * seen.shape[1]
        is_lost = np.zeros(n, np.bool_)
        is_lost[rng.permutation(n)[: round(self.share * n)]] = True
        shear = lattice.interpolate(fill_lost(seen, is_lost.reshape(seen.shape[:2])))
        return np.concatenate([shear, depth[..., None]], axis=-1)
