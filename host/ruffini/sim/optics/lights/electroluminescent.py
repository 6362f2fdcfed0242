"""A glowing sheet behind translucent pyramids that look through openings in a black mask.

Pressing thins the translucent layer between sheet and window: by Beer and Lambert the light that comes through gets
exp(compression / attenuation) times brighter. A pyramid takes up light over its whole base and scatters it: an opening
is as bright as the mean of that over its base. The surface that moves is the sheet; mask and window stay.
"""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats, by_component, dot
from ruffini.sim.optics.patterns.lattice import Lattice
from ruffini.sim.optics.settings import Electroluminescent
from ruffini.sim.optics.surface import DeformedSurface, Hits

N_BASE = 5  # places along each side of a base over which its light is summed (midpoints)


class Openings:
    """The mask's openings as the pixels of one view see them; it is bonded to the window and does not move."""

    def __init__(self, light: Electroluminescent, lattice: Lattice, rest: Hits) -> None:
        self._light = light
        offset = light.aperture_um * 1e-3 * ((np.arange(N_BASE) + 0.5) / N_BASE - 0.5)
        across, along = (grid.reshape(-1, 1).astype(np.float32) for grid in np.meshgrid(offset, offset))
        a, b = lattice.places()
        self._bases: tuple[Floats, Floats] = (a + across, b + along)  # (places of a base, openings) each
        da, db, self._opening = lattice.nearest(rest.a, rest.b)
        inside = light.aperture_um * 5e-4 - np.maximum(np.abs(da), np.abs(db))
        cover = np.clip(inside / (light.blur_um * 1e-3) + 0.5, 0, 1) * rest.is_inside
        leak = light.leak_1e3 * 1e-3
        self.cover = np.asarray(leak * rest.is_inside + (1 - leak) * cover, dtype=np.float32)
        tint = np.array(light.tint_1e3, dtype=np.float32)
        self._tinted_cover = by_component(self.cover[..., None] * tint * np.float32(1e-3))

    def shade(self, surface: DeformedSurface, lamp_gain: Floats) -> Floats:
        """Light of the openings, (h, w, 3) B G R."""
        a, b = self._bases
        normal, u = surface.look(surface.inward, a, b), surface.look(surface.displacement, a, b)
        inward_mm = dot(u, normal) / np.linalg.norm(normal, axis=-1)
        through = np.exp(np.maximum(inward_mm, 0) / np.float32(self._light.attenuation_um * 1e-3))
        brighter = lamp_gain[0] * through.mean(axis=0)
        return np.asarray(self._tinted_cover * brighter.astype(np.float32)[self._opening][..., None])
