"""Height of MuJoCo's geoms over a pad: how far above the pad's face the underside of each is, along the pad's normal.

Spheres, ellipsoids, capsules, cylinders, boxes and planes exactly; a mesh as its convex hull, as MuJoCo's own
collisions take it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PARALLEL = 1e-12  # of a ray to a face or an axis


@dataclass(frozen=True)
class Hull:
    """A convex body as half-spaces: points p with `normal` p <= `offset` (m, 3) and (m,), in the geom's axes."""

    normal: Array
    offset: Array

    @classmethod
    def of_mesh(cls, model: Any, mesh: int) -> Hull:
        """The convex hull of a model's mesh."""
        from scipy.spatial import ConvexHull

        equations = np.unique(np.round(ConvexHull(mesh_vertices(model, mesh)).equations, 9), axis=0)
        return cls(equations[:, :3], -equations[:, 3])

    def entry(self, start: Array, way: Array) -> Array:
        """Where rays from `start` (n, 3) along `way` (3,) enter, (n,); inf where they miss."""
        along = self.normal @ way
        gap = self.offset[:, None] - self.normal @ start.T
        enters, leaves = along < -PARALLEL, along > PARALLEL
        first = (gap[enters] / along[enters, None]).max(axis=0, initial=-np.inf)
        last = (gap[leaves] / along[leaves, None]).min(axis=0, initial=np.inf)
        beside = (gap[~(enters | leaves)] < 0).any(axis=0)
        return np.where((first < last) & ~beside, first, np.inf)


def mesh_vertices(model: Any, mesh: int) -> Array:
    """Vertices of a model's mesh, (n, 3) metres in the geom's axes."""
    first = model.mesh_vertadr[mesh]
    return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], np.float64)


def _quadric(start: Array, way: Array, scale: Array) -> tuple[Array, Array]:
    """Both places where rays meet |p * scale| = 1; inf, -inf where they do not, or never leave an endless one."""
    s, w = start * scale, way * scale
    a, b, c = w @ w, s @ w, np.einsum("ij,ij->i", s, s) - 1
    if a < PARALLEL:
        return np.where(c < 0, -np.inf, np.inf), np.where(c < 0, np.inf, -np.inf)
    square = b * b - a * c
    hit = square > 0
    root = np.sqrt(np.where(hit, square, 0.0))
    return np.where(hit, (-b - root) / a, np.inf), np.where(hit, (-b + root) / a, -np.inf)


def _ellipsoid(start: Array, way: Array, size: Array) -> Array:
    return _quadric(start, way, 1 / size)[0]


def _cylinder(start: Array, way: Array, radius: float, half: float) -> Array:
    first, last = _quadric(start, way, np.array([1 / radius, 1 / radius, 0.0]))
    if abs(way[2]) < PARALLEL:
        return np.where(np.abs(start[:, 2]) < half, first, np.inf)
    middle, reach = -start[:, 2] / way[2], half / abs(way[2])  # between the two ends
    enters = np.maximum(first, middle - reach)
    return np.where(enters < np.minimum(last, middle + reach), enters, np.inf)


def entry(kind: str, size: Array, start: Array, way: Array, hull: Hull | None = None) -> Array:
    """Where rays from `start` (n, 3) along the unit vector `way` (3,) enter a geom, (n,) metres; inf: they miss it.

    `start` and `way` are in the geom's axes. A start inside the geom has a negative entry.
    """
    if hull is not None:
        return hull.entry(start, way)
    if kind == "sphere":
        return _ellipsoid(start, way, np.repeat(size[0], 3))
    if kind == "ellipsoid":
        return _ellipsoid(start, way, size)
    if kind == "cylinder":
        return _cylinder(start, way, size[0], size[1])
    ends = [_ellipsoid(start - np.array([0, 0, z]), way, np.repeat(size[0], 3)) for z in (-size[1], size[1])]
    return np.minimum(np.minimum(*ends), _cylinder(start, way, size[0], size[1]))  # a capsule
