"""How much of a fingertip's wall lies in the tool's plane, straight from the pins' displacements: nothing is fitted.

A flat tool flattens the wall under it. Pins' tips are read on a fine lattice about the touched place; what is within
FLAT_MM of the furthest tips along the tool's axis lies in its plane. The wall that buckles inwards under the middle of
the tool has left it and does not count, nor does the tool's face where the wall has not come up to it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ruffini.estimators.fingertip.field import turn_to_top
from ruffini.estimators.fingertip.turns import between

Array = npt.NDArray[np.float64]

FLAT_MM = 0.3  # well above the noise of a tip's height, 0.02 to 0.07 mm
N_TOP = 6  # points that tell where the plane is: of the highest one noise has most
STEP_MM, REACH_MM = 1.0, 12.0  # of the lattice, along the surface


@lru_cache(maxsize=4)
def lattice(radius_mm: float) -> Array:
    """Directions (g, 3) of a square lattice about the top."""
    line = np.arange(-REACH_MM, REACH_MM + STEP_MM / 2, STEP_MM)
    at = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    way = np.linalg.norm(at, axis=1)
    at, way = at[way <= REACH_MM], way[way <= REACH_MM]
    sideways = at * (np.sin(way / radius_mm) / np.maximum(way, 1e-9))[:, None]
    return np.column_stack([sideways, np.cos(way / radius_mm)])


def lattice_at(middle: Array, radius_mm: float) -> Array:
    """The lattice (g, 3) about a direction (3,)."""
    return np.asarray(lattice(radius_mm) @ turn_to_top(middle[None])[0])


def flat_area(points: Array, axis: Array) -> float:
    """mm^2 of a lattice's deformed points (g, 3) mm that lie in the plane that they touch along `axis` (3,)."""
    height = points @ axis
    top = np.sort(height)[-N_TOP:].mean()
    return float((height > top - FLAT_MM).sum() * STEP_MM**2)


def area_of_pins(moved: Array, place: Array, normal: Array, axis: Array, radius_mm: float) -> float:
    """From displacements (n, 3) of tips at `place` (n, 3) mm with outward normals (n, 3), under a tool of this axis."""
    inward = np.maximum(-(moved * normal).sum(axis=1), 0)
    middle = inward**2 @ normal
    at = lattice_at(middle / np.linalg.norm(middle), radius_mm)
    return flat_area(between(normal, at) @ (place + moved), axis)


def read_nodes(nodes: Array, size_mm: float, at: Array) -> Array:
    """Displacements (n, n, 3) at nodes over the dome's outline seen from above, `size_mm` wide, read at (m, 2) mm."""
    from scipy.interpolate import RectBivariateSpline

    line = np.linspace(-size_mm / 2, size_mm / 2, len(nodes))
    columns = [RectBivariateSpline(line, line, nodes[..., i])(at[:, 1], at[:, 0], grid=False) for i in range(3)]
    return np.stack(columns, axis=1)


def area_of_nodes(nodes: Array, size_mm: float, middle: Array, axis: Array, radius_mm: float) -> float:
    """From displacements of the wall as `read_nodes` has them, about a direction `middle` (3,)."""
    at = radius_mm * lattice_at(middle, radius_mm)
    return flat_area(at + read_nodes(nodes, size_mm, at[:, :2]), axis)
