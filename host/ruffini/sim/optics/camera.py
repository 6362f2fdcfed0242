"""Rays of every pixel, and pixels of points: pinhole, lens distortion, place, mirror, refraction.

A view looks along +z from (0, 0, -standoff). Lens models are OpenCV's (radial-tangential, fisheye).
A mirror reflects the whole view. Through a clear pad the ray bends at the pad's flat back (Snell's
law); the pinhole then stands so that the middle of the picture keeps board.toml's scale. Through a clear tube it
bends in the wall (`optics.wall`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.optics.settings import LensSettings, ViewSettings
from ruffini.sim.optics.wall import TubeWall

Array = npt.NDArray[np.float64]
NEWTON_ROUNDS = 30
SETTLED = 1e-13  # of the focal length: far below what any picture shows
MAX_ANGLE = 1.7  # radians from the axis: what a fisheye can still see


def distort(lens: LensSettings | None, direction: Array) -> Array:
    """Directions (n, 3) of a camera that looks along +z -> image places over focal length, (n, 2)."""
    if lens is not None and lens.model == "fisheye":
        around = np.hypot(direction[:, 0], direction[:, 1])
        angle = np.arctan2(around, direction[:, 2])
        scale = np.divide(_fisheye_angle(lens, angle), around, out=np.zeros_like(around), where=around > 0)
        return direction[:, :2] * scale[:, None]
    plane = direction[:, :2] / direction[:, 2:]
    return plane if lens is None else _radtan(lens, plane)


def _radtan(lens: LensSettings, plane: Array) -> Array:
    k1, k2, p1, p2, k3 = (c * 1e-6 for c in lens.coefficients_1e6)
    x, y = plane[:, 0], plane[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
    )


def _fisheye_angle(lens: LensSettings, angle: Array) -> Array:
    k1, k2, k3, k4 = (c * 1e-6 for c in lens.coefficients_1e6)
    a2 = angle * angle
    return np.asarray(angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))))


def undistort(lens: LensSettings | None, place: Array) -> Array:
    """Inverse of `distort`: directions (n, 3); z = 1 but for a fisheye, whose directions have length 1."""
    if lens is None:
        return np.column_stack([place, np.ones(len(place))])
    if lens.model == "fisheye":
        bent = np.hypot(place[:, 0], place[:, 1])
        table = np.linspace(0, MAX_ANGLE, 20_001)
        angle = np.interp(bent, _fisheye_angle(lens, table), table)
        scale = np.divide(np.sin(angle), bent, out=np.zeros_like(bent), where=bent > 0)
        return np.column_stack([place * scale[:, None], np.cos(angle)])
    plane, step = place.copy(), 1e-6
    along_x, along_y = np.array([step, 0.0]), np.array([0.0, step])
    for _ in range(NEWTON_ROUNDS):
        wrong = _radtan(lens, plane) - place
        if np.abs(wrong).max(initial=0) < SETTLED:
            break
        jx = (_radtan(lens, plane + along_x) - _radtan(lens, plane - along_x)) / (2 * step)
        jy = (_radtan(lens, plane + along_y) - _radtan(lens, plane - along_y)) / (2 * step)
        det = jx[:, 0] * jy[:, 1] - jx[:, 1] * jy[:, 0]
        plane[:, 0] -= (jy[:, 1] * wrong[:, 0] - jy[:, 0] * wrong[:, 1]) / det
        plane[:, 1] -= (jx[:, 0] * wrong[:, 1] - jx[:, 1] * wrong[:, 0]) / det
    return np.column_stack([plane, np.ones(len(plane))])


def rotation(turn_rad: Array) -> Array:
    """Rotation by turn[0] about x, then turn[1] about y, then turn[2] about z, (3, 3)."""
    out = np.eye(3)
    for axis, angle in enumerate(turn_rad):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[j, j] = np.cos(angle)
        one[j, i], one[i, j] = np.sin(angle), -np.sin(angle)
        out = one @ out
    return out


@dataclass
class View:
    """One part of the frame: a pinhole with its lens and, if any, its mirror; millimetres."""

    board: Board
    settings: ViewSettings
    lens: LensSettings | None
    n_views: int = 1
    refractive_index: float = 1.0
    wall: TubeWall | None = None

    def __post_init__(self) -> None:
        camera = self.board.camera
        self.width_px, self.height_px = camera.width_px // self.n_views, camera.height_px
        self.focal_px = camera.focal_mpx * 1e-3
        self._center_px = np.array([camera.center_x_mpx, camera.center_y_mpx]) * 1e-3
        self.thickness_mm = self.board.pad.thickness_um * 1e-3
        # A plate of thickness t and index n lifts what is behind it by t (1 - 1/n).
        lift = self.thickness_mm * (1 - 1 / self.refractive_index)
        self._pinhole = np.array(self.settings.offset_um) * 1e-3 - [0, 0, camera.standoff_um * 1e-3 + lift]
        self._turn = rotation(np.array(self.settings.turn_mrad) * 1e-3)
        mirror = self.settings.mirror
        self._mirror = None
        if mirror is not None:
            normal = np.array(mirror.normal_1e3, dtype=float)
            self._mirror = (np.array(mirror.point_um) * 1e-3, normal / np.linalg.norm(normal))

    def rays(self) -> tuple[Array, Array]:
        """Origin and direction of every pixel's ray on its last way to the surface, (h, w, 3) each."""
        v, u = np.mgrid[: self.height_px, : self.width_px].astype(float)
        place = (np.column_stack([u.ravel(), v.ravel()]) - self._center_px) / self.focal_px
        direction = undistort(self.lens, place) @ self._turn.T
        origin = np.broadcast_to(self._pinhole, direction.shape)
        if self._mirror is not None:
            point, normal = self._mirror
            origin = origin - 2 * ((origin - point) @ normal)[:, None] * normal
            direction = direction - 2 * (direction @ normal)[:, None] * normal
        if self.refractive_index != 1:
            origin, direction = self._refracted(origin, direction)
        if self.wall is not None:
            origin, direction = self.wall.refracted(origin, direction)
        shape = (self.height_px, self.width_px, 3)
        return origin.reshape(shape), direction.reshape(shape)

    def _refracted(self, origin: Array, direction: Array) -> tuple[Array, Array]:
        t = (-self.thickness_mm - origin[:, 2]) / direction[:, 2]
        unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        sideways = unit[:, :2] / self.refractive_index
        forward = np.sqrt(1 - (sideways**2).sum(axis=1))
        return origin + t[:, None] * direction, np.column_stack([sideways, forward])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) and distance along the axis (n,) of points before the pad's back or the tube's wall."""
        if self._mirror is not None:
            point, normal = self._mirror
            points = points - 2 * ((points - point) @ normal)[:, None] * normal
        seen = (points - self._pinhole) @ self._turn
        return distort(self.lens, seen) * self.focal_px + self._center_px, seen[:, 2]
