"""Pictures moved by known smooth fields: the truth that image trackers are judged on.

A field b maps places of the moved picture to places of the still one, moved(p) = still(p + b(p)), so rendering needs no
inversion: a spline of order 5 reads the still picture, an interpolator that no tracker here uses. What was at X in the
still picture is then at the p with p + b(p) = X.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SPLINE_ORDER = 5
INVERSION_ROUNDS = 60  # each gains a factor of about 10: the fields stretch by a tenth
SHIFT_SHARE = 0.45  # of the largest motion
STRETCH = 0.03  # of the linear part, each entry
BULGE_SHARE = 0.45  # of the largest motion, in the middle of the local part
SWELL = 0.08  # of the local part
GAIN = 0.15  # largest local change of brightness
NOISE_LEVELS = 1.5  # standard deviation of what the camera adds


@dataclass(frozen=True)
class Warp:
    """A shift, a linear part and a local part of Gaussian extent: b(p), and the local gain of the light."""

    center_px: Array
    shift_px: Array
    linear: Array
    width_px: float
    bulge_px: Array
    swell: float
    gain_center_px: Array
    gain: float

    @classmethod
    def random(cls, rng: np.random.Generator, size_px: tuple[int, int], largest_px: float) -> Warp:
        """A field over a picture of (width, height) that moves by about `largest_px` at most."""
        size = np.array(size_px, dtype=float)
        return cls(
            center_px=size * rng.uniform(0.35, 0.65, 2),
            shift_px=SHIFT_SHARE * largest_px * rng.uniform(-1, 1, 2),
            linear=rng.uniform(-STRETCH, STRETCH, (2, 2)),
            width_px=float(size.min() * rng.uniform(0.15, 0.25)),
            bulge_px=BULGE_SHARE * largest_px * rng.uniform(-1, 1, 2),
            swell=float(rng.uniform(-SWELL, SWELL)),
            gain_center_px=size * rng.uniform(0.2, 0.8, 2),
            gain=float(rng.uniform(-GAIN, GAIN)),
        )

    def back(self, place_px: Array) -> Array:
        """b at (..., 2) places."""
        away = place_px - self.center_px
        local = np.exp(-(away**2).sum(axis=-1) / (2 * self.width_px**2))[..., None]
        return np.asarray(self.shift_px + away @ self.linear.T + local * (self.bulge_px + self.swell * away))

    def forward(self, place_px: Array) -> Array:
        """Displacement of what was at (..., 2) places of the still picture."""
        at = place_px.copy()
        for _ in range(INVERSION_ROUNDS):
            at = place_px - self.back(at)
        return np.asarray(at - place_px)

    def render(self, still: Picture, rng: np.random.Generator) -> Picture:
        """The moved picture with its local gain and noise, (h, w, c) uint8."""
        height, width = still.shape[:2]
        y, x = np.mgrid[:height, :width].astype(float)
        place = np.stack([x, y], axis=-1)
        at = place + self.back(place)
        channels = [
            map_coordinates(still[..., c].astype(float), [at[..., 1], at[..., 0]], order=SPLINE_ORDER, mode="nearest")
            for c in range(still.shape[2])
        ]
        spread = 0.2 * (width + height)
        bright = np.exp(-((place - self.gain_center_px) ** 2).sum(axis=-1) / (2 * spread**2))
        levels = np.stack(channels, axis=-1) * (1 + self.gain * bright)[..., None]
        noisy = levels + rng.normal(0, NOISE_LEVELS, levels.shape)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)
