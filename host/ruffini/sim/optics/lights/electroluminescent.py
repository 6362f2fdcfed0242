"""A glowing sheet behind translucent pyramids that look through openings in a black mask.

Pressing thins the translucent layer between sheet and window: by Beer and Lambert an opening gets
exp(compression / attenuation) times brighter. Its brightness follows the compression of the layer
over the opening's middle, as the pyramid scatters light over its whole base.
"""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.patterns.lattice import Lattice
from ruffini.sim.optics.settings import Electroluminescent
from ruffini.sim.optics.surface import DeformedSurface, Hits


class Openings:
    """The mask's openings as the pixels of one view see them; it is bonded to the window and does not move."""

    def __init__(self, light: Electroluminescent, lattice: Lattice, rest: Hits) -> None:
        self._light = light
        da, db, self._middle_a, self._middle_b = lattice.nearest(rest.a, rest.b)
        inside = light.aperture_um * 5e-4 - np.maximum(np.abs(da), np.abs(db))
        cover = np.clip(inside / (light.blur_um * 1e-3) + 0.5, 0, 1) * rest.is_inside
        leak = light.leak_1e3 * 1e-3
        self.cover = np.asarray(leak * rest.is_inside + (1 - leak) * cover, dtype=np.float32)

    def shade(self, surface: DeformedSurface, lamp_gain: Floats) -> Floats:
        """Light of the openings, (h, w, 3) B G R."""
        normal = surface.look(surface.inward, self._middle_a, self._middle_b)
        u = surface.look(surface.displacement, self._middle_a, self._middle_b)
        inward_mm = np.einsum("...i,...i", u, normal) / np.sqrt(np.einsum("...i,...i", normal, normal))
        brighter = np.exp(np.maximum(inward_mm, 0) / np.float32(self._light.attenuation_um * 1e-3))
        tint = np.array(self._light.tint_1e3, dtype=np.float32) * np.float32(1e-3 * lamp_gain[0])
        return np.asarray((self.cover * brighter)[..., None] * tint, dtype=np.float32)
