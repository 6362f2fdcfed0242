"""One run of the experiment, as the core and the truth tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FORCE, Z, X, Y, ROLL, PITCH, AREA = range(7)


@dataclass(frozen=True)
class Played:
    """One run, frames of 0.05 to 1.05 of full scale. truth, ours (t, 7) QUANTITIES, area in mm^2; sigma (t, 7);
    is_known, is_whole (t,) whether the features were known and the whole face is below the undeformed dome; frame_ms
    (t,) of the core.
    """

    name: str
    tool: str
    truth: Array
    ours: Array
    sigma: Array
    is_known: npt.NDArray[np.bool_]
    is_whole: npt.NDArray[np.bool_]
    frame_ms: Array

    @property
    def off(self) -> Array:
        """Errors (t, 7); of the area in percent, NaN where it is not told."""
        off = self.ours - self.truth
        off[self.ours[:, AREA] == 0, AREA] = np.nan
        off[:, AREA] *= 100 / self.truth[:, AREA]
        return np.asarray(off)
