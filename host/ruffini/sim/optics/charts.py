"""Undeformed surfaces and their material coordinates (a, b), millimetres.

The pad frame has its origin in the middle of the surface (of the axis, for a tube), x right and y down
in the image, z away from the camera. A chart says where a material point is, and where a ray meets
the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.boards import Pad
from ruffini.sim.optics.settings import ShapeSettings

Floats = npt.NDArray[np.float32]


def by_component(vectors: Floats) -> Floats:
    """The same vectors (..., n) with each component contiguous in memory, which makes arithmetic by component fast."""
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(vectors, -1, 0)), 0, -1)


def dot(p: Floats, q: Floats) -> Floats:
    """Scalar products of vectors (..., 3)."""
    return np.asarray(p[..., 0] * q[..., 0] + p[..., 1] * q[..., 1] + p[..., 2] * q[..., 2])


class Chart(Protocol):
    """One kind of surface."""

    def points(self, a: Floats, b: Floats) -> Floats:
        """Places (..., 3) of material points."""

    def intersect(self, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Material coordinates of the places where rays (..., 3) meet the surface ahead."""

    def half_size(self, pad: Pad) -> tuple[float, float]:
        """Largest |a| and |b| of the surface that board.toml's [pad] describes, millimetres."""


@dataclass(frozen=True)
class Plane:
    """z = 0; a = x, b = y."""

    def points(self, a: Floats, b: Floats) -> Floats:
        return np.moveaxis(np.stack([a, b, np.zeros_like(a)]), 0, -1)

    def intersect(self, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
        t = -origin[..., 2] / direction[..., 2]
        return origin[..., 0] + t * direction[..., 0], origin[..., 1] + t * direction[..., 1]

    def half_size(self, pad: Pad) -> tuple[float, float]:
        return pad.size_x_um * 5e-4, pad.size_y_um * 5e-4


def _ahead(origin: Floats, direction: Floats, radius: float, n_axes: int) -> Floats:
    """Ray parameter of the exit from a sphere (3 axes) or cylinder (2) about the origin; NaN where it misses."""
    o, d = origin[..., :n_axes], direction[..., :n_axes]
    dd, od, oo = (np.einsum("...i,...i", p, q) for p, q in ((d, d), (o, d), (o, o)))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((np.sqrt(od * od - dd * (oo - np.float32(radius**2))) - od) / dd, dtype=np.float32)


@dataclass(frozen=True)
class Tube:
    """Cylinder about the z axis, seen from inside; a = radius times angle from x, b = z."""

    radius: float

    def points(self, a: Floats, b: Floats) -> Floats:
        angle = a / self.radius
        return np.stack([self.radius * np.cos(angle), self.radius * np.sin(angle), b], axis=-1)

    def intersect(self, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
        hit = origin + _ahead(origin, direction, self.radius, 2)[..., None] * direction
        return (self.radius * np.arctan2(hit[..., 1], hit[..., 0])).astype(np.float32), hit[..., 2]

    def half_size(self, pad: Pad) -> tuple[float, float]:
        return np.pi * self.radius, pad.size_y_um * 5e-4


@dataclass(frozen=True)
class Dome:
    """Half sphere with its top at the origin, on a cylinder; (a, b) = way along the surface from the top."""

    radius: float

    def points(self, a: Floats, b: Floats) -> Floats:
        way = np.hypot(a, b)
        angle = np.minimum(way / self.radius, np.pi / 2)
        # sin(angle) / way without 0 / 0 at the top
        out = self.radius * np.sin(angle) / np.maximum(way, 1e-9)
        out = np.where(way < 1e-6, 1.0, out)
        z = self.radius * (np.cos(angle) - 1) - np.maximum(way - self.radius * np.pi / 2, 0)
        return np.stack([a * out, b * out, z], axis=-1).astype(np.float32)

    def intersect(self, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
        center = np.array([0, 0, -self.radius], dtype=np.float32)
        hit = origin + _ahead(origin - center, direction, self.radius, 3)[..., None] * direction
        wall = origin + _ahead(origin, direction, self.radius, 2)[..., None] * direction
        hit = np.where((hit[..., 2] >= -self.radius)[..., None], hit, wall)
        around = np.hypot(hit[..., 0], hit[..., 1])
        z = hit[..., 2] + self.radius
        way = self.radius * np.arctan2(around, np.maximum(z, 0)) + np.maximum(-z, 0)
        scale = np.where(around > 0, way / np.maximum(around, 1e-9), 1)
        return (hit[..., 0] * scale).astype(np.float32), (hit[..., 1] * scale).astype(np.float32)

    def half_size(self, pad: Pad) -> tuple[float, float]:
        """Down to the rim of the half sphere; the wall below is not modelled."""
        return np.pi / 2 * self.radius, np.pi / 2 * self.radius


def chart_of(shape: ShapeSettings) -> Chart:
    """The chart that [shape] names."""
    if shape.kind == "plane":
        return Plane()
    return (Tube if shape.kind == "tube" else Dome)(shape.radius_um * 1e-3)
