"""Lambertian light of near lamps: cosine of the angle to the lamp over the distance squared."""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats, dot
from ruffini.sim.optics.surface import Hits


def lamp(hits: Hits, place_mm: Floats) -> Floats:
    """What one lamp of power 1 gives the surface, (h, w)."""
    to_lamp = place_mm - hits.point
    distance2 = dot(to_lamp, to_lamp)
    cosine = np.maximum(dot(hits.normal, to_lamp), 0)
    return np.asarray(cosine / (distance2 * np.sqrt(distance2)), dtype=np.float32)
