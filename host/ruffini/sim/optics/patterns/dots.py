"""Round printed dots on the surface."""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.patterns.lattice import Lattice
from ruffini.sim.optics.settings import DotSettings
from ruffini.sim.optics.surface import Hits


def transmission(dots: DotSettings, lattice: Lattice, diameter_um: int, hits: Hits) -> Floats:
    """What the dots leave of the light, (h, w)."""
    da, db, _ = lattice.nearest(hits.a, hits.b)
    edge = (diameter_um * 5e-4 - np.hypot(da, db)) / (dots.blur_um * 1e-3)
    return np.asarray(1 - dots.darkness_1e3 * 1e-3 * np.clip(edge + 0.5, 0, 1), dtype=np.float32)
