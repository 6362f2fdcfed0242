"""What a frame's own light makes of all colours alike, as firmware/image/light.h measures it.

Cameras that set their white or exposure again under every touch change all pixels by one factor a channel: on recorded
presses blue by -8 to +16 % and red by -14 to +5 %, as much as a slope of 30 degrees does.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SAMPLE_PX, SAMPLE_ROWS = 8, 2
STEP_X, STEP_Y, FIRST = 16, 8, 4
USABLE = (32.0, 220.0)  # grey levels of rest: bright enough, not full
LEAST_EVEN = 0.75  # darkest over brightest pixel of a sample's row: less is the edge of a dot
NEAR = 0.08  # of the level
ROUNDS = 3
MOST = 0.25


def light_level(change: Array, reference: Array) -> Array:
    """Relative change (3,) that the light makes, of an image's (h, w, 3); zero where nothing tells it."""
    height, width = reference.shape[:2]
    sample = []
    for y in range(FIRST, height - SAMPLE_ROWS + 1, STEP_Y):
        for x in range(FIRST, width - SAMPLE_PX + 1, STEP_X):
            place = (slice(y, y + SAMPLE_ROWS), slice(x, x + SAMPLE_PX))
            if _is_usable(reference[place]):
                sample.append(change[place].mean(axis=(0, 1)))
    if not sample:
        return np.zeros(3)
    samples = np.array(sample)
    level = np.median(samples, axis=0)
    for _ in range(ROUNDS):
        near = (np.abs(samples - level) <= NEAR).all(axis=1)
        if 8 * near.sum() < len(samples):
            break
        level = samples[near].mean(axis=0)
    return np.asarray(np.clip(level, -MOST, MOST))


def _is_usable(rest: Array) -> bool:
    least, most = rest.min(axis=1), rest.max(axis=1)
    is_lit = least.min() >= USABLE[0] and most.max() <= USABLE[1]
    return bool(is_lit and (least >= LEAST_EVEN * most).all())
