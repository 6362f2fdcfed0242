"""Three near lamps, one for each colour, as photometric stereo wants them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.lights.lamps import lamp
from ruffini.sim.optics.settings import RgbLeds
from ruffini.sim.optics.surface import Hits


def shade(light: RgbLeds, hits: Hits, gain: Floats, place_mm: Floats, lamp_of: npt.NDArray[np.int_]) -> Floats:
    """Light of the lamps' parts at `place_mm` on what the pixels see, (h, w, 3) B G R.

    lamp_of : (n,) number of the lamp, 0 B, 1 G, 2 R, that each part belongs to.
    """
    single = [np.zeros(hits.a.shape, dtype=np.float32) for _ in range(3)]
    for i, part_gain, place in zip(lamp_of, gain, place_mm, strict=True):
        if part_gain > 0:
            single[i] += np.float32(light.power_1e3[i] * 1e-3 * part_gain) * lamp(hits, place)
    leak = np.float32(light.crosstalk_1e3 * 1e-3)
    total = leak * (single[0] + single[1] + single[2])
    return np.moveaxis(np.stack([(1 - 3 * leak) * s + total for s in single]), 0, -1)


def places(light: RgbLeds) -> Floats:
    """Places of the lamps, (3, 3) mm."""
    return np.array([light.led_b_um, light.led_g_um, light.led_r_um], dtype=np.float32) * np.float32(1e-3)
