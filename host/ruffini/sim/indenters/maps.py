"""Indenters from data: height maps, and triangle meshes as the height maps of their lower side."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.files import readable

Array = npt.NDArray[np.float64]

FLANK = 1.0  # rise over run beyond the map, and below overhangs
MAX_MAP_LINES = 2000  # along one axis


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights on an even grid about the indenter's axis, bilinear between, 45 degree flanks beyond.

    heights : (n_y, n_x) float64, metres over the lowest point; step_m between lines of the grid.
    """

    heights: Array
    step_m: float

    def __post_init__(self) -> None:
        if self.heights.ndim != 2 or min(self.heights.shape) < 2 or not self.step_m > 0:
            raise InputError("a height map needs at least 2 x 2 heights and a positive step")
        if not np.isfinite(self.heights).all() or self.heights.min() != 0:
            raise InputError("a height map's heights must be finite, and 0 at their lowest point")

    @property
    def reach_m(self) -> float:
        """Half of its larger side."""
        return float((max(self.heights.shape) - 1) * self.step_m / 2)

    def __call__(self, x: Array, y: Array) -> Array:
        rows, columns = self.heights.shape
        u = x / self.step_m + (columns - 1) / 2
        v = y / self.step_m + (rows - 1) / 2
        u_in, v_in = np.clip(u, 0, columns - 1), np.clip(v, 0, rows - 1)
        i, j = np.minimum(u_in.astype(int), columns - 2), np.minimum(v_in.astype(int), rows - 2)
        s, t = u_in - i, v_in - j
        h = self.heights
        inside = (1 - t) * ((1 - s) * h[j, i] + s * h[j, i + 1]) + t * ((1 - s) * h[j + 1, i] + s * h[j + 1, i + 1])
        return np.asarray(inside + FLANK * self.step_m * np.hypot(u - u_in, v - v_in))


def read_stl(path: Path) -> Array:
    """Triangles (n, 3, 3) of an STL file, binary or text, in the file's unit.

    Raises
    ------
    InputError
        It cannot be read, or is no STL.
    """
    try:
        data = readable(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check the path") from error
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
        triangles = np.frombuffer(data, record, offset=84)["corners"].astype(np.float64)
    else:
        number = rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?"
        found = re.findall(rb"vertex\s+(%s)\s+(%s)\s+(%s)" % (number, number, number), data)
        if not data.lstrip().startswith(b"solid") or len(found) % 3:
            raise InputError(f"{path}: no STL file: neither its length nor its text fits")
        triangles = np.array(found, dtype=float).reshape(-1, 3, 3)
    if not len(triangles) or not np.isfinite(triangles).all():
        raise InputError(f"{path}: holds no triangles with finite corners: export it again")
    return triangles


def map_of_triangles(triangles_m: Array, step_m: float) -> HeightMap:
    """The lower side of a mesh (n, 3, 3) as a height map about the middle of its outline; -z touches the pad.

    Where nothing of the mesh is above the grid, the map rises from its edge at 45 degrees.

    Raises
    ------
    InputError
        The mesh is flat or the step does not suit its size.
    """
    low, high = triangles_m.min(axis=(0, 1)), triangles_m.max(axis=(0, 1))
    n_x, n_y = (int(np.ceil((high[c] - low[c]) / step_m)) + 1 for c in (0, 1))
    if min(n_x, n_y) < 3 or max(n_x, n_y) > MAX_MAP_LINES:
        raise InputError(
            f"a mesh of {(high[0] - low[0]) * 1e3:g} x {(high[1] - low[1]) * 1e3:g} mm at {step_m * 1e3:g} mm makes "
            f"{n_x} x {n_y} heights: 3 to {MAX_MAP_LINES} lines are allowed, check the unit and the step"
        )
    x = (low[0] + high[0]) / 2 + (np.arange(n_x) - (n_x - 1) / 2) * step_m
    y = (low[1] + high[1]) / 2 + (np.arange(n_y) - (n_y - 1) / 2) * step_m
    z = np.full((n_y, n_x), np.inf)
    for triangle in triangles_m:
        _lower(z, x, y, triangle)
    known = np.isfinite(z)
    if not known.any():
        raise InputError("the mesh has no side that looks down on the pad: it is thinner than the step")
    if not known.all():
        from scipy.ndimage import distance_transform_edt

        away, (row, column) = distance_transform_edt(~known, return_indices=True)
        z = z[row, column] + FLANK * step_m * away
    return HeightMap(z - z.min(), step_m)


def _lower(z: Array, x: Array, y: Array, triangle: Array) -> None:
    """Lower z to a triangle where that is below it."""
    (ax, ay, _), (bx, by, _), (cx, cy, _) = triangle
    twice_area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if twice_area == 0:
        return  # seen from its edge
    i0, i1 = np.searchsorted(x, [triangle[:, 0].min(), triangle[:, 0].max()], side="left")
    j0, j1 = np.searchsorted(y, [triangle[:, 1].min(), triangle[:, 1].max()], side="left")
    px, py = np.meshgrid(x[i0 : i1 + 1], y[j0 : j1 + 1])
    b = ((px - ax) * (cy - ay) - (cx - ax) * (py - ay)) / twice_area
    c = ((bx - ax) * (py - ay) - (px - ax) * (by - ay)) / twice_area
    tolerance = -1e-9
    covered = (b >= tolerance) & (c >= tolerance) & (b + c <= 1 - tolerance)
    height = triangle[0, 2] + b * (triangle[1, 2] - triangle[0, 2]) + c * (triangle[2, 2] - triangle[0, 2])
    part = z[j0 : j1 + 1, i0 : i1 + 1]
    part[...] = np.where(covered, np.minimum(part, height), part)
