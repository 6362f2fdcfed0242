"""What the board makes of its markers: those lost take their neighbours' mean, nodes interpolate over the lattice.

The float twin of firmware/image/markers.cpp (fill_lost); the bit-exact tests hold it to the core within its rounding.
The nodes: `ruffini.calibrate.marker_lattice`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

from ruffini.calibrate.marker_lattice import NodesOnLattice

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


def fill_lost(u: Array, is_lost: Bools) -> Array:
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
