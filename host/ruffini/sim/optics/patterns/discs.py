"""Discs that are not printed on the surface: tips of pins inside it, targets on the tray below it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.sim.optics.camera import View
from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.settings import PinSettings
from ruffini.sim.optics.surface import DeformedSurface

Array = npt.NDArray[np.float64]


def draw(light: Floats, view: View, places_mm: Array, radius_mm: float, level: float) -> None:
    """Paint discs that face the camera into a view's light (h, w, 3), the nearest last."""
    at, distance = view.project(places_mm)
    height, width = light.shape[:2]
    for i in np.argsort(-distance, kind="stable"):
        if distance[i] <= 0:
            continue
        radius = radius_mm * view.focal_px / distance[i]
        x0, x1 = max(int(at[i, 0] - radius) - 1, 0), min(int(at[i, 0] + radius) + 3, width)
        y0, y1 = max(int(at[i, 1] - radius) - 1, 0), min(int(at[i, 1] + radius) + 3, height)
        if x0 >= x1 or y0 >= y1:
            continue
        away = np.hypot(np.arange(x0, x1) - at[i, 0], np.arange(y0, y1)[:, None] - at[i, 1])
        cover = np.clip(radius - away + 0.5, 0, 1)[..., None].astype(np.float32)
        light[y0:y1, x0:x1] += cover * (np.float32(level) - light[y0:y1, x0:x1])


def pin_feet(pins: PinSettings) -> tuple[Floats, Floats]:
    """Material places of the n hexagonal lattice points nearest to the middle, mm, (n,) each."""
    pitch = pins.pitch_um * 1e-3
    reach = int(np.sqrt(pins.n)) + 2
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    a, b = pitch * (i + j / 2).ravel(), pitch * np.sqrt(3) / 2 * j.ravel()
    # Equal distances are ordered by angle, so that the choice does not hang on rounding.
    order = np.lexsort((np.arctan2(b, a).round(6), np.hypot(a, b).round(6)))[: pins.n]
    return a[order].astype(np.float32), b[order].astype(np.float32)


def pin_tips(pins: PinSettings, surface: DeformedSurface, feet: tuple[Floats, Floats]) -> Array:
    """Places of the pins' tips: they stand on the surface and turn with it, (n, 3) mm."""
    a, b = (f[None, :] for f in feet)
    foot = surface.look(surface.place, a, b)[0]
    inward = surface.look(surface.inward, a, b)[0]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    return np.asarray(foot + pins.length_um * 1e-3 * inward, dtype=float)
