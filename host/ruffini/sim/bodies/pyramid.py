"""A rubber pyramid between two plates, and a bed of them under a sheet.

The pyramid is a tapered bar of neo-Hookean rubber, each slice in plain compression (sections stay flat, no friction):

    F = mu A(z) (1 / s^2 - s),   A(z) = (b z / h)^2,   shortening = integral over h of (1 - s) dz,   mu = E / 3.

Without any length of its own near the tip, F goes with the square of the shortening, as every cone's does; it gets
stiffer as the base takes part. Beside the pyramids the sheet meets a black mask when it has come down by a gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from ruffini.sim.bodies.sheet import Sheet
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

N_SLICES, N_LOADS = 4000, 400
SMALLEST_SLICE = 1e-6  # of the height
LARGEST_PART = 0.9  # of the height, shortened; stiff in a straight line from there
NEWTON_ROUNDS = 60


def slice_stretch(pressure: Array) -> Array:
    """Stretch s of a slice under nominal pressure over mu: 1 / s^2 - s = pressure."""
    out = np.where(pressure < 1, 1 - pressure / 3, 1 / np.sqrt(1 + pressure))
    left, p, s = np.arange(out.size), pressure.ravel(), out.ravel()
    for _ in range(NEWTON_ROUNDS):
        after = np.maximum(s - (p - 1 / s**2 + s) / (2 / s**3 + 1), 0.1 * s)
        moves = after != s
        left, p, s = left[moves], p[moves], after[moves]
        if not left.size:
            break
        out.flat[left] = s
    return np.asarray(out)


def bar_shortening(force: Array, area: Array, z: Array, shear_pa: float) -> Array:
    """Of a tapered bar with sections `area` (m,) at `z` (m,), metres, under forces (k,), newtons: (k,)."""
    stretch = slice_stretch(force[:, None] / (shear_pa * area))
    return np.asarray(np.trapezoid(1 - stretch, z, axis=1))


@dataclass(frozen=True)
class PyramidLaw:
    """Force (N) over shortening (m) of one pyramid of side `base_m` and height `height_m`."""

    base_m: float
    height_m: float
    modulus_pa: float

    def curve(self) -> PchipInterpolator:
        """Force against shortening from 0 to LARGEST_PART of the height."""
        return _curve(self)


@lru_cache(maxsize=8)  # a second to make, and the same for every panel of a skin
def _curve(law: PyramidLaw) -> PchipInterpolator:
    z = law.height_m * np.geomspace(SMALLEST_SLICE, 1, N_SLICES)
    scale = law.modulus_pa * law.base_m**2
    force = scale * np.geomspace(1e-10, 1e3, N_LOADS)
    short = bar_shortening(force, (law.base_m * z / law.height_m) ** 2, z, law.modulus_pa / 3)
    kept = short < LARGEST_PART * law.height_m
    return PchipInterpolator(np.append(0.0, short[kept]), np.append(0.0, force[kept]))


@dataclass(frozen=True)
class BedNumbers:
    """What a bed is made of: SI units; `squeezed_m` is how far its pyramids are pressed at rest by the skin's hug."""

    pyramid: PyramidLaw
    squeezed_m: float
    mask_gap_m: float
    mask_pa_m: float  # pressure per way once the mask is met
    shear_pa_m: float  # of the pyramids' bases, sideways
    relaxation: Prony


class PyramidBed:
    """Pyramids under a sheet (`sheet.Foundation`): their bases share their force evenly."""

    def __init__(self, sheet: Sheet, in_base: Bools, numbers: BedNumbers) -> None:
        self._sheet, self._in_base, self._n = sheet, in_base, numbers
        curve = numbers.pyramid.curve()
        area = numbers.pyramid.base_m**2
        self._curve, self._slope, self._end = curve, curve.derivative(), float(curve.x[-1])
        self._area = area
        self._hug = float(curve(numbers.squeezed_m)) / area
        self._memory = Memory(numbers.relaxation)
        self._elastic: Array = np.zeros(in_base.shape)
        normal = sheet.normals.reshape(-1, 3)
        self._normal, self._across = normal, np.eye(3) - normal[:, :, None] * normal[:, None, :]
        functions = sheet.sampled[0]
        along = functions[..., :, None] * sheet.normals[..., None, :]
        self._along = along.reshape(*functions.shape[:2], 48)
        self._sideways = sheet.spread(numbers.shear_pa_m * in_base.reshape(-1, 1, 1) * self._across)

    def begin(self, duration_s: float) -> None:
        self._memory.begin(duration_s)

    def _pressure(self, down: Array) -> tuple[Array, Array]:
        """Elastic pressure over that at rest, Pa, and its slope, Pa/m, where samples went down."""
        short = np.clip(down + self._n.squeezed_m, 0, None)
        inside = np.minimum(short, self._end)
        slope = self._slope(inside) / self._area
        pressure = self._curve(inside) / self._area + slope * (short - inside) - self._hug
        pressure, slope = np.where(self._in_base, pressure, 0.0), np.where(self._in_base & (short > 0), slope, 0.0)
        over = down - self._n.mask_gap_m
        pressure += self._n.mask_pa_m * np.maximum(over, 0)
        return pressure, slope + np.where(over > 0, self._n.mask_pa_m, 0.0)

    def hold(self, moved: Array) -> tuple[Array, Callable[[], Array]]:
        shape = self._in_base.shape
        down = -(moved * self._normal).sum(axis=1).reshape(shape)
        self._elastic, slope = self._pressure(down)
        factor = self._memory.factor
        push = factor * self._elastic + self._memory.held
        least = np.where(self._in_base, -self._hug, 0.0)
        lifted = push < least  # pyramids push, they do not pull
        push, slope = np.where(lifted, least, push), np.where(lifted, 0.0, factor * slope)
        areas = self._sheet.touch_areas
        force = (push * areas).reshape(-1, 1) * self._normal
        sideways = (self._across @ moved[..., None])[..., 0]
        force -= (self._n.shear_pa_m * self._in_base * areas).reshape(-1, 1) * sideways

        def tangent() -> Array:
            weighted = self._along * (slope * areas)[..., None]
            return np.asarray(weighted.swapaxes(1, 2) @ self._along + self._sideways)

        return force, tangent

    def commit(self) -> None:
        self._memory.commit(self._elastic)
