"""White lamps evenly spaced on a ring about the camera's axis.

A translucent layer before a black one scatters less light where it is squeezed thin and more where it is raised: by
Beer and Lambert exp(-compression / darkening) of that at rest. The light enters through the layer's flat back and comes
out of its depth, so the slope of its face does not shade it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ruffini.sim.optics.charts import Floats, dot
from ruffini.sim.optics.lights.lamps import lamp
from ruffini.sim.optics.settings import WhiteRing
from ruffini.sim.optics.surface import Hits


def shade(light: WhiteRing, hits: Hits, lamp_gain: Floats, place_mm: Floats) -> Floats:
    """Light of the ring on what the pixels see, (h, w, 3) B G R."""
    if light.darkening_um:
        hits = replace(hits, normal=np.broadcast_to(np.array([0, 0, -1], np.float32), hits.normal.shape))
    total = np.zeros(hits.a.shape, dtype=np.float32)
    for place, gain in zip(place_mm, lamp_gain, strict=True):
        if gain > 0:
            total += np.float32(gain) * lamp(hits, place)
    if light.darkening_um:
        inward_mm = dot(hits.displacement, hits.normal)
        total *= np.exp(-inward_mm / np.float32(light.darkening_um * 1e-3))
    tint = np.array(light.tint_1e3, dtype=np.float32)
    return np.moveaxis(np.stack([total * t * np.float32(1e-3) for t in tint]), 0, -1)


def places(light: WhiteRing) -> Floats:
    """Places of the lamps, (n, 3) mm."""
    angle = 2 * np.pi * np.arange(light.n_leds) / light.n_leds
    ring = light.radius_um * 1e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([ring, np.full(light.n_leds, light.z_um * 1e-3)]).astype(np.float32)
