"""A recording of image features beside a reference wrench, wherever it was read from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.estimators.wrench.warmth import Degrees

Array = npt.NDArray[np.float64]
UNNAMED = "a tip without a name"


@dataclass(frozen=True)
class FeatureRun:
    """One recording from rest on.

    features (t, n) raw integers at time_s (t,), is_good (t,) nothing lost; reference (r, 6) N and N m at reference_s
    (r,); degrees (t,) where the board has a thermometer. `touch` (t,) numbers the touches where the log does;
    `recording` names the recording of a run that is only one touch of it; `kind` what pressed, where the log says it.
    """

    name: str
    time_s: Array
    features: Array
    is_good: npt.NDArray[np.bool_]
    reference_s: Array
    reference: Array
    degrees: Degrees | None = None
    touch: npt.NDArray[np.intp] | None = None
    recording: str = ""
    kind: str = ""

    @property
    def is_row_by_row(self) -> bool:
        """Whether the reference was read once for each frame, at the frame's own time."""
        return self.reference_s is self.time_s

    def at(self, lag_s: float) -> Array:
        """Reference of each frame (t, 6) where it is read `lag_s` after what the camera sees."""
        return self.at_each(np.array([lag_s]))[:, 0]

    def at_each(self, lags_s: Array) -> Array:
        """The same at each lag, (t, lags, 6)."""
        when = self.time_s[:, None] + lags_s
        return np.stack([np.interp(when, self.reference_s, column) for column in self.reference.T], axis=2)
