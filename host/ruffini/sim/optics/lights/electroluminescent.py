"""A glowing sheet behind translucent pyramids that look through openings in a black mask.

Pressing thins the translucent layer between sheet and window: by Beer and Lambert an opening gets
exp(compression / attenuation) times brighter. Its brightness follows the compression of the layer
over the opening's middle, as the pyramid scatters light over its whole base. The surface that moves is the
sheet; mask and window stay.
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
        self._light, self._lattice = light, lattice
        da, db, self._opening = lattice.nearest(rest.a, rest.b)
        inside = light.aperture_um * 5e-4 - np.maximum(np.abs(da), np.abs(db))
        cover = np.clip(inside / (light.blur_um * 1e-3) + 0.5, 0, 1) * rest.is_inside
        leak = light.leak_1e3 * 1e-3
        self.cover = np.asarray(leak * rest.is_inside + (1 - leak) * cover, dtype=np.float32)
        self._tinted_cover = self.cover[..., None] * np.array(light.tint_1e3, dtype=np.float32) * np.float32(1e-3)

    def shade(self, surface: DeformedSurface, lamp_gain: Floats) -> Floats:
        """Light of the openings, (h, w, 3) B G R."""
        a, b = (place[None, :] for place in self._lattice.places())
        normal, u = surface.look(surface.inward, a, b)[0], surface.look(surface.displacement, a, b)[0]
        inward_mm = np.einsum("ij,ij->i", u, normal) / np.linalg.norm(normal, axis=1)
        brighter = lamp_gain[0] * np.exp(np.maximum(inward_mm, 0) / np.float32(self._light.attenuation_um * 1e-3))
        return np.asarray(self._tinted_cover * brighter.astype(np.float32)[self._opening][..., None])
