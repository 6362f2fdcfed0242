"""Place and force of a touch from the brightness of an electroluminescent skin, as section IV of its paper has them.

A frame less the initial one, green + blue, smoothed; the brightest pixel is the contact (single contact). Undistorted
with k1 and k2 it gives r and theta about the principal point, and on a cylinder of radius R
    eq. (3)  r / f = R / (d + Z)
with f and d by least squares from known points. Force F(I) = p1 I^2 + p2 I + p3, fitted to all of the data.
The paper's eq. (6) multiplies captured coordinates by the lens' polynomial; that is the wrong direction for Zhang's
model, whose k1 and k2 it prints, and is taken as a slip: coordinates are undistorted as that model says. The
smoothing filter is not printed: a Gaussian of 2 px, as wider ones mix openings, which are 8 px apart at the far end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SIGMA_PX = 2.0
LEAST_REGION_PX = 400  # of several contacts


def brightness(now: Picture, initial: Array) -> Array:
    """Green + blue over the initial picture (h, w, 3; B G R), smoothed, (h, w)."""
    import cv2

    change = now[..., :2].astype(np.float64).sum(axis=-1) - initial[..., :2].sum(axis=-1)
    return np.asarray(cv2.GaussianBlur(change, (0, 0), SIGMA_PX))


def brightest(change: Array) -> tuple[float, float, float]:
    """Pixel u, v of the largest brightness, and that."""
    v, u = np.unravel_index(int(np.argmax(change)), change.shape)
    return float(u), float(v), float(change[v, u])


def regions(change: Array, level: float) -> Array:
    """Centroid u, v and mean brightness of each connected region above `level` of enough pixels, (n, 3)."""
    import cv2

    binary = (change > level).astype(np.uint8)
    n, labels, stats, centres = cv2.connectedComponentsWithStats(binary)
    found = [i for i in range(1, n) if stats[i, cv2.CC_STAT_AREA] > LEAST_REGION_PX]
    return np.array([(*centres[i], change[labels == i].mean()) for i in found]).reshape(-1, 3)


@dataclass(frozen=True)
class Camera:
    """Zhang's model: focal lengths and principal point (px), k1 and k2."""

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float

    def polar(self, u: float, v: float) -> tuple[float, float]:
        """Undistorted distance from the principal point (px) and angle."""
        import cv2

        matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])
        lens = np.array([self.k1, self.k2, 0, 0])
        x, y = cv2.undistortPoints(np.array([[[u, v]]]), matrix, lens)[0, 0]
        return float(np.hypot(self.fx * x, self.fy * y)), float(np.arctan2(y, x))


@dataclass(frozen=True)
class Cylinder:
    """f (px), d (mm) and R (mm) of eq. (3)."""

    f: float
    d: float
    radius: float

    @classmethod
    def fit(cls, r: Array, z: Array, radius: float) -> Cylinder:
        """From points at radii r (px) with known Z (mm): r (d + Z) = f R."""
        (f, d), *_ = np.linalg.lstsq(np.column_stack([np.full_like(r, radius), -r]), r * z, rcond=None)
        return cls(float(f), float(d), radius)

    def place(self, r: float, theta: float) -> Array:
        """Point (3,) on the cylinder, mm."""
        return np.array([self.radius * np.cos(theta), self.radius * np.sin(theta), self.f * self.radius / r - self.d])


def force_curve(intensity: Array, force: Array) -> Array:
    """p1, p2, p3 by least squares, (3,)."""
    return np.asarray(np.polyfit(intensity, force, 2))
