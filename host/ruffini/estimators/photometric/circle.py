"""One contact in one picture, whatever the gel's response to slope is.

A ball's slope is the same to the left and to the right of its centre but for the sign, and so is the gel's round it. A
coloured gel changes its light in proportion, so the change of light is odd about the contact's centre in every channel;
a gel that darkens by depth is even. The centre is first where

    S(p) = -sum_o d(p + o) . d(p - o)

is largest over all offsets o: no threshold, no response and no radius enters. Then the circle is fitted to the light
round it: slope towards the centre f(r) that rises inside the radius, with a cubic part for responses that saturate, and
decays outside; per channel its two gains, their gradient over the picture, a level and an even part are linear and
solved for. The crease of f tells the circle even where lamps drift, since a level tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from ruffini.estimators.photometric.change import SMOOTHED_PX, Change

Array = npt.NDArray[np.float64]

COARSE_PX = 9  # reach of the search for the centre, pixels of its own coarse picture
REACH = 1.2, 0.35  # of the search: ball radii, and at most that share of the picture's shorter side
LEAST_RADIUS_PX = 4.0  # of a contact, on the picture that is worked on
MOST_RADIUS = 0.45  # of the picture's shorter side
WINDOW = 1.7  # radii that the circle is fitted on
FITTED_PIXELS = 1200
RADIUS_BOUNDS = 0.4, 1.6  # of the first guess
KINKED, SMOOTH = 1, 2  # power of the distance by which the slope decays outside: with a kink at the edge, or without
TURNS = 3  # a fit that ends near a bound, or moved far, starts again there
SECTORS = 8  # of the circle inside and outside, whose misfits are taken as independent


@dataclass(frozen=True)
class Circle:
    """A contact in the picture; sigmas are one standard deviation, 0 where nothing tells them (marks by hand)."""

    center_x_px: float
    center_y_px: float
    radius_px: float
    center_sigma_px: float = 0.0
    radius_sigma_px: float = 0.0


@dataclass(frozen=True)
class Contact:
    """A circle on the picture that is worked on; `misfit`: share of the light's change round it left unexplained."""

    circle: Circle
    misfit: float
    is_at_bound: bool


def odd_centre(light: Array, ball_px: float) -> tuple[float, float, float]:
    """Where the change of light (h, w, 3) is most odd, x and y in pixels, and S there."""
    height, width = light.shape[:2]
    reach_px = max(min(REACH[0] * ball_px, REACH[1] * min(height, width)), LEAST_RADIUS_PX)
    scale = min(COARSE_PX / reach_px, 1.0)
    size = (max(round(width * scale), 8), max(round(height * scale), 8))
    coarse = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    n = max(round(reach_px * scale), 3)
    rows, columns = coarse.shape[:2]
    padded = np.pad(coarse, ((n, n), (n, n), (0, 0)))
    odd = np.zeros((rows, columns))
    for dy in range(n + 1):
        for dx in range(-n, n + 1):
            if (dy == 0 and dx <= 0) or dx * dx + dy * dy > n * n:
                continue
            ahead = padded[n + dy : n + dy + rows, n + dx : n + dx + columns]
            behind = padded[n - dy : n - dy + rows, n - dx : n - dx + columns]
            odd -= np.einsum("ijk,ijk->ij", ahead, behind)
    row, column = divmod(int(odd.argmax()), columns)
    x, y = (column + 0.5) * width / columns - 0.5, (row + 0.5) * height / rows - 0.5
    return float(x), float(y), float(odd.max())


def odd_radius(light: Array, x: float, y: float) -> tuple[float, float]:
    """Radius at which the part of the light that is odd about a centre is largest, pixels, and its size there."""
    height, width = light.shape[:2]
    rows, columns = np.indices((height, width))
    dx, dy = columns - x, rows - y
    away = np.hypot(dx, dy)
    n = max(int(MOST_RADIUS * min(height, width)), int(3 * LEAST_RADIUS_PX))
    near = away < n
    ring = away[near].astype(int)
    count = np.maximum(np.bincount(ring, minlength=n), 1)
    power: Array = np.zeros(n)
    for channel in range(3):
        for along in (dx, dy):
            part = (light[..., channel] * along / np.maximum(away, 1e-9))[near]
            power += (np.bincount(ring, part, minlength=n) / count) ** 2
    size = np.convolve(np.sqrt(power), np.ones(3) / 3, "same")[:-2]
    first = int(LEAST_RADIUS_PX)
    peak = first + int(size[first:].argmax())
    return peak + 0.5, float(size[peak])


def fit_circle(change: Change, x: float, y: float, radius_px: float, leaving: int = KINKED) -> Contact:
    """The circle that explains the light round a first guess best; the gel leaves the ball `KINKED` or `SMOOTH`."""
    height, width = change.light.shape[:2]
    most_px = 2 * MOST_RADIUS * min(height, width)
    found = _Fit(change, x, y, radius_px, leaving).run()
    for _ in range(TURNS - 1):
        circle = found.circle
        has_left = np.hypot(circle.center_x_px - x, circle.center_y_px - y) > 0.3 * radius_px
        if not (found.is_at_bound or has_left or abs(circle.radius_px / radius_px - 1) > 0.25):
            break
        x, y, radius_px = (
            circle.center_x_px,
            circle.center_y_px,
            float(np.clip(circle.radius_px, LEAST_RADIUS_PX, most_px)),
        )
        found = _Fit(change, x, y, radius_px, leaving).run()
    return found


class _Fit:
    """Least squares of one window."""

    def __init__(self, change: Change, x: float, y: float, radius_px: float, leaving: int) -> None:
        self.leaving = leaving
        self.first = np.array([x, y, radius_px, np.log(0.5)])
        self.reach_px = WINDOW * radius_px
        rows, columns = np.asarray(np.indices(change.light.shape[:2]), dtype=np.int64)
        near = (np.hypot(columns - x, rows - y) < self.reach_px) & change.is_usable
        step = max(int(np.sqrt(near.sum() / FITTED_PIXELS)), 1)
        near = np.asarray(near & (rows % step == 0) & (columns % step == 0), dtype=np.bool_)
        self.x, self.y = columns[near].astype(float), rows[near].astype(float)
        self.light = change.light[near]
        self.total = float(((self.light - self.light.mean(axis=0)) ** 2).sum()) if near.any() else 0.0
        self.step = 0.5
        self.grid = np.arange(0, 2.5 * self.reach_px, self.step)
        sigma = SMOOTHED_PX / self.step
        self.half = int(3 * sigma)
        kernel = np.exp(-0.5 * (np.arange(-self.half, self.half + 1) / sigma) ** 2)
        self.kernel = kernel / kernel.sum()

    def _profile(self, away: Array, radius: float, decay: float, power: int) -> Array:
        inside = np.minimum(self.grid / radius, 1.0) ** power
        f = inside * np.exp(-((np.maximum(self.grid - radius, 0) / decay) ** self.leaving))
        whole = np.concatenate([-f[1 : self.half + 2][::-1], f])
        return np.interp(away, self.grid, np.convolve(whole, self.kernel, "same")[self.half + 1 :])

    def _terms(self, place: Array) -> Array:
        x, y, radius, decay = place[0], place[1], place[2], self.first[2] * np.exp(place[3])
        dx, dy = self.x - x, self.y - y
        away = np.hypot(dx, dy)
        ux, uy = dx / np.maximum(away, 1e-6), dy / np.maximum(away, 1e-6)
        f, cubic = (self._profile(away, radius, decay, power) for power in (1, 3))
        px, py = (self.x - self.first[0]) / self.reach_px, (self.y - self.first[1]) / self.reach_px
        a, b = ux * f, uy * f
        return np.stack([a, b, ux * cubic, uy * cubic, a * px, a * py, b * px, b * py, np.ones_like(f), f * f], axis=1)

    def _residual(self, place: Array) -> Array:
        basis = np.linalg.qr(self._terms(place))[0]
        return np.asarray(self.light - basis @ (basis.T @ self.light))

    def _cost(self, place: Array) -> float:
        radius = self.first[2]
        is_far = np.hypot(*(place[:2] - self.first[:2])) > radius
        if is_far or not RADIUS_BOUNDS[0] * radius < place[2] < RADIUS_BOUNDS[1] * radius or abs(place[3]) > 3:
            return 9.0
        return float((self._residual(place) ** 2).sum()) / self.total

    def run(self) -> Contact:
        """The best circle of this window."""
        radius = self.first[2]
        if len(self.x) < 50 or self.total == 0:
            return Contact(Circle(float(self.first[0]), float(self.first[1]), float(radius)), 1.0, True)
        simplex = self.first + np.vstack([np.zeros(4), np.diag([0.08 * radius, 0.08 * radius, 0.12 * radius, 0.7])])
        options = {"initial_simplex": simplex, "xatol": 0.03, "fatol": 1e-6, "maxfev": 160}
        best = minimize(self._cost, self.first, method="Nelder-Mead", options=options)
        sigma = self._sigma(best.x)
        low, high = RADIUS_BOUNDS
        is_at_bound = not 1.03 * low * radius < best.x[2] < 0.97 * high * radius
        x, y, fitted = (float(v) for v in best.x[:3])
        circle = Circle(x, y, fitted, float(np.hypot(sigma[0], sigma[1]) / np.sqrt(2)), float(sigma[2]))
        return Contact(circle, min(float(best.fun), 1.0), is_at_bound)

    def _sigma(self, place: Array) -> Array:
        """Standard deviations, with the misfit of each sector, inside and outside, taken as one independent error."""
        left = self._residual(place)
        steps = (0.2, 0.2, 0.2, 0.1)
        slope = np.stack([(self._residual(place + d) - left) / d.sum() for d in np.diag(steps)], axis=-1)
        angle = np.arctan2(self.y - place[1], self.x - place[0]) / (2 * np.pi) + 0.5
        outside = np.hypot(self.x - place[0], self.y - place[1]) > place[2]
        sector = (angle * SECTORS).astype(int) % SECTORS + SECTORS * outside
        pull = np.einsum("nci,nc->ni", slope, left)
        sums = np.stack([np.bincount(sector, pull[:, i], minlength=2 * SECTORS) for i in range(4)], axis=1)
        curve = np.einsum("nci,ncj->ij", slope, slope)
        inverse = np.linalg.inv(curve + 1e-9 * np.trace(curve) * np.eye(4))
        return np.sqrt(np.diag(inverse @ (sums.T @ sums) @ inverse))
