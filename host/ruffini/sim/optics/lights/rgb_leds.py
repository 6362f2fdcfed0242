"""Three near lamps, one for each colour, as photometric stereo wants them."""

from __future__ import annotations

import numpy as np

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.lights.lamps import lamp
from ruffini.sim.optics.settings import RgbLeds
from ruffini.sim.optics.surface import Hits


def shade(light: RgbLeds, hits: Hits, lamp_gain: Floats, place_mm: Floats) -> Floats:
    """Light of the three lamps at `place_mm` on what the pixels see, (h, w, 3) B G R."""
    single = [
        np.float32(power * 1e-3 * gain) * lamp(hits, place)
        for place, power, gain in zip(place_mm, light.power_1e3, lamp_gain, strict=True)
    ]
    leak = np.float32(light.crosstalk_1e3 * 1e-3)
    total = leak * (single[0] + single[1] + single[2])
    return np.stack([(1 - 3 * leak) * s + total for s in single], axis=-1)


def places(light: RgbLeds) -> Floats:
    """Places of the lamps, (3, 3) mm."""
    return np.array([light.led_b_um, light.led_g_um, light.led_r_um], dtype=np.float32) * np.float32(1e-3)
