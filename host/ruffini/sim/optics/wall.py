"""The clear tube between pinhole and mask: rays that cross its wall (Snell's law).

A camera on the axis looks along the wall, not through it: at 76 degrees from the normal 2 mm of acrylic move what lies
behind them by about 6 mm along the tube, so that the outer face appears to be within 2 mm of where the inner one is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TubeWall:
    """Round the z axis of the pad's frame. outer_mm : radius of the face on which the skin lies."""

    outer_mm: float
    thickness_mm: float
    index: float

    @property
    def inner_mm(self) -> float:
        """Radius of the face that the rays meet first."""
        return self.outer_mm - self.thickness_mm

    def refracted(self, origin: Array, direction: Array) -> tuple[Array, Array]:
        """Rays (..., 3) from inside the tube as they go on within its wall: where they enter it, unit directions."""
        unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        o, d = origin[..., :2], unit[..., :2]
        dd, od, oo = (np.einsum("...i,...i", p, q) for p, q in ((d, d), (o, d), (o, o)))
        with np.errstate(invalid="ignore", divide="ignore"):  # a ray along the axis never meets the wall
            way = (np.sqrt(od * od - dd * (oo - self.inner_mm**2)) - od) / dd
            entry = origin + way[..., None] * unit
            outward = np.concatenate([entry[..., :2] / self.inner_mm, np.zeros_like(entry[..., :1])], axis=-1)
            along = np.einsum("...i,...i", unit, outward)[..., None]
            sideways = (unit - along * outward) / self.index
            return entry, sideways + np.sqrt(1 - (sideways**2).sum(axis=-1, keepdims=True)) * outward
