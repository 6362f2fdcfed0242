"""Force of a rubber pyramid over how far it is pressed in, without its size: a tapered bar of neo-Hookean slices.

    slice    F = mu A (1 / s^2 - s),   A = (z / h)^2 b^2,   shortening = integral of (1 - s) dz,   mu = E / 3

gives F / (E b^2) over shortening / h: at first with its square, as any cone, then stiffer as the base takes part.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

Array = npt.NDArray[np.float64]

N_SLICES, N_LOADS, NEWTON_ROUNDS = 2000, 400, 60
SMALLEST_SLICE = 1e-6  # of the height
LARGEST_PART = 0.89  # of the height, shortened


@lru_cache(maxsize=1)
def _curve() -> PchipInterpolator:
    z, force = np.geomspace(SMALLEST_SLICE, 1, N_SLICES), np.geomspace(1e-10, 1e3, N_LOADS)
    pressure = 3 * force[:, None] / z**2
    s = np.where(pressure < 1, 1 - pressure / 3, 1 / np.sqrt(1 + pressure))
    for _ in range(NEWTON_ROUNDS):
        s = np.maximum(s - (pressure - 1 / s**2 + s) / (2 / s**3 + 1), 0.1 * s)
    short = np.trapezoid(1 - s, z, axis=1)
    kept = short < LARGEST_PART + 0.01
    return PchipInterpolator(np.append(0.0, short[kept]), np.append(0.0, force[kept]))


def pyramid_force(part: Array) -> Array:
    """F / (E b^2) of a pyramid shortened by `part` of its height; held beyond LARGEST_PART."""
    return np.asarray(_curve()(np.clip(part, 0, LARGEST_PART)))
