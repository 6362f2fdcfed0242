"""Coloured flakes in the surface. Each is a small mirror, tilted its own way, that flashes where the
half-way direction between camera and lamps comes near its normal."""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.settings import GlitterSettings
from ruffini.sim.optics.surface import DeformedSurface, Hits, Surface

N_COLOURS = 3  # blue, green, red


class Glitter:
    """Flakes drawn once, by seed, on a map in material coordinates."""

    def __init__(self, settings: GlitterSettings, surface: Surface, seed: int) -> None:
        import cv2

        self._settings = settings
        rng = np.random.default_rng(seed)
        size = surface.fine_a[-1] - surface.fine_a[0], surface.fine_b[-1] - surface.fine_b[0]
        n = round(settings.per_mm2_1e3 * 1e-3 * size[0] * size[1])
        at, tilt = rng.uniform(0, 1, (n, 2)), rng.normal(0, settings.tilt_mrad * 1e-3, (n, 2))
        colour = rng.integers(0, N_COLOURS, n)
        radius_mm = settings.diameter_um * 5e-4 * rng.uniform(0.7, 1.3, n)
        rows, columns = len(surface.fine_b), len(surface.fine_a)
        cover = np.zeros((rows, columns, 3), dtype=np.float32)
        self._tilt = np.zeros((rows, columns, 2), dtype=np.float32)
        step_mm, sub = size[0] / (columns - 1), 4  # bits of sub-pixel place that OpenCV draws with
        for i in range(n):
            place = (at[i] * [columns - 1, rows - 1] * 2**sub).round().astype(int)
            radius = max(round(radius_mm[i] / step_mm * 2**sub), 1)
            value = np.eye(3)[colour[i]]
            cv2.circle(cover, place.tolist(), radius, value.tolist(), -1, cv2.LINE_8, sub)
            cv2.circle(self._tilt, place.tolist(), radius, tilt[i].tolist(), -1, cv2.LINE_8, sub)
        self._cover = np.asarray(cv2.GaussianBlur(cover, (3, 3), 0), dtype=np.float32)

    def add(self, light: Floats, surface: DeformedSurface, hits: Hits, half_way: Floats) -> Floats:
        """Light with the flakes' flashes: a lobe about each flake's own normal."""
        cover = surface.look(self._cover, hits.a, hits.b) * hits.is_inside[..., None]
        tilt = surface.look(self._tilt, hits.a, hits.b)
        # Small angles: the flake's normal is the surface's, moved sideways by its tilt.
        off = half_way[..., :2] - hits.normal[..., :2] - tilt
        lobe, matte = np.float32(self._settings.lobe_mrad * 1e-3), np.float32(self._settings.matte_1e3 * 1e-3)
        flash = matte + (1 - matte) * np.exp(-(off[..., 0] ** 2 + off[..., 1] ** 2) / (2 * lobe * lobe))
        strength = np.float32(self._settings.strength_1e3 * 1e-3)
        grey = light.mean(axis=-1, keepdims=True)
        body = light * (1 - cover.sum(axis=-1, keepdims=True))
        return np.asarray(body + strength * grey * cover * flash[..., None], dtype=np.float32)
