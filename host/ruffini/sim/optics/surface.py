"""The deformed surface on a fine grid, and where rays meet it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from ruffini.sim.optics.charts import Chart, Floats, dot

Array = npt.NDArray[np.float64]
RAY_TOLERANCE_MM = 0.5e-3  # of the ray's fixed point: below 0.01 px
MAX_RAY_ROUNDS = 40  # where the surface hides a part of itself there is no fixed point
MAX_FINE = 1200  # grid lines along one axis


def _fine(nodes: Array, step: float) -> Array:
    n = min(round((nodes[-1] - nodes[0]) / step), MAX_FINE) + 1
    return np.linspace(nodes[0], nodes[-1], n)


def _spline(nodes: Array, at: Array) -> tuple[Array, Array]:
    """Matrices that take nodal values to a cubic spline's values and slopes at `at`."""
    spline = make_interp_spline(nodes, np.eye(len(nodes)), k=3)
    return spline(at), spline.derivative()(at)


@dataclass
class Hits:
    """What the pixels see: material coordinates (h, w), place and inward unit normal (h, w, 3), mm."""

    a: Floats
    b: Floats
    point: Floats
    normal: Floats
    is_inside: npt.NDArray[np.bool_]
    displacement: Floats


class Surface:
    """A chart with displacements at the nodes of a rectangle in its coordinates.

    Parameters
    ----------
    node_a_mm, node_b_mm : (n_a,), (n_b,) material coordinates of the nodes.
    step_mm : of the fine grid.
    """

    def __init__(self, chart: Chart, node_a_mm: Array, node_b_mm: Array, step_mm: float) -> None:
        self.chart = chart
        self.shape = (len(node_b_mm), len(node_a_mm))
        self.fine_a, self.fine_b = _fine(node_a_mm, step_mm), _fine(node_b_mm, step_mm)
        self._to_a, self._slope_a = _spline(node_a_mm, self.fine_a)
        self._to_b, self._slope_b = _spline(node_b_mm, self.fine_b)
        half = np.float32(step_mm / 2)
        a, b = np.meshgrid(self.fine_a.astype(np.float32), self.fine_b.astype(np.float32))
        self._rest = _planes(chart.points(a, b))
        self._rest_a = _planes((chart.points(a + half, b) - chart.points(a - half, b)) / (2 * half))
        self._rest_b = _planes((chart.points(a, b + half) - chart.points(a, b - half)) / (2 * half))

    def deform(self, displacement_m: Array) -> DeformedSurface:
        """The surface with nodal displacements (n_b, n_a, 3) or (n, 3), metres."""
        import cv2

        u_mm = displacement_m.reshape(*self.shape, 3) * 1e3
        u, along_a, along_b = np.empty((3, 3, len(self.fine_b), len(self.fine_a)), np.float32)
        for c in range(3):
            value = self._to_b @ u_mm[:, :, c]
            u[c] = value @ self._to_a.T
            along_a[c] = value @ self._slope_a.T
            along_b[c] = self._slope_b @ u_mm[:, :, c] @ self._to_a.T
        along_a += self._rest_a
        along_b += self._rest_b
        place, inward = self._rest + u, _cross(along_b, along_a)
        return DeformedSurface(self, *(cv2.merge(list(planes)) for planes in (u, place, inward)))


def _planes(vectors: Floats) -> Floats:
    """(..., 3) as (3, ...), each component contiguous."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _cross(p: Floats, q: Floats) -> Floats:
    """Of vectors (3, ...); faster than numpy.cross on whole pictures."""
    out = np.empty_like(p)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = p[j] * q[k] - p[k] * q[j]
    return out


def _largest(change: Floats) -> float:
    """Largest size; NaN, of a ray that misses, counts only where all are."""
    size = np.abs(change)
    largest = float(size.max())
    return float(np.nanmax(size)) if np.isnan(largest) else largest


@dataclass
class DeformedSurface:
    """Displacement, place and inward normal (not of length 1) on the fine grid, (n_b, n_a, 3), mm."""

    surface: Surface
    displacement: Floats
    place: Floats
    inward: Floats

    def look(self, grid: Floats, a: Floats, b: Floats) -> Floats:
        """Bilinear values of a fine grid at material coordinates, `by_component`; the border's beyond the border."""
        import cv2

        fine_a, fine_b = self.surface.fine_a, self.surface.fine_b
        u = (a - np.float32(fine_a[0])) / np.float32(fine_a[1] - fine_a[0])
        v = (b - np.float32(fine_b[0])) / np.float32(fine_b[1] - fine_b[0])
        values = cv2.remap(grid, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        planes = np.empty((values.shape[-1], *a.shape), np.float32)
        cv2.split(values, list(planes))
        return np.moveaxis(planes, 0, -1)

    def hit(self, origin: Floats, direction: Floats) -> Hits:
        """Where rays meet the surface: the material point m with rest(m) = origin - u(m) + t direction."""
        a, b = self.surface.chart.intersect(origin, direction)
        for _ in range(MAX_RAY_ROUNDS):
            next_a, next_b = self.surface.chart.intersect(origin - self.look(self.displacement, a, b), direction)
            change = max(_largest(next_a - a), _largest(next_b - b))
            a, b = next_a, next_b
            if change < RAY_TOLERANCE_MM:
                break
        fine_a, fine_b = self.surface.fine_a, self.surface.fine_b
        is_inside = (a >= fine_a[0]) & (a <= fine_a[-1]) & (b >= fine_b[0]) & (b <= fine_b[-1])
        if not (np.isfinite(a).all() and np.isfinite(b).all()):  # rays that miss
            a, b = np.nan_to_num(a), np.nan_to_num(b)
        normal = self.look(self.inward, a, b)
        normal /= np.sqrt(dot(normal, normal))[..., None]
        u = self.look(self.displacement, a, b)
        return Hits(a, b, self.surface.chart.points(a, b) + u, normal, is_inside, u)
