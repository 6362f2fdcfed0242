"""What temperature does to a wrench of features: an offset and a gain a kelvin for each axis.

firmware/stages/feature_wrench/wrench_warmth.h has the equation. Units here: N and N mm, degrees Celsius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LEAST_RANGE_K = 2.0  # in a log: less says nothing that the thermometer's own error could not


@dataclass(frozen=True)
class Degrees:
    """How warm it is in every frame (t,), and was when the rest of that frame was learned (t,); NaN: not measured."""

    now: Array
    rest: Array

    @classmethod
    def unknown(cls, n: int) -> Degrees:
        return cls(np.full(n, np.nan), np.full(n, np.nan))

    def take(self, which: npt.NDArray[np.bool_]) -> Degrees:
        return Degrees(self.now[which], self.rest[which])

    @property
    def why_not(self) -> str | None:
        """Why nothing can be said of temperature, where nothing can."""
        if not np.isfinite(self.now).all():
            return "not measured in every recording"
        if np.ptp(self.now) < LEAST_RANGE_K:
            return f"it varies by {np.ptp(self.now):.1f} K only"
        return None


@dataclass(frozen=True)
class WrenchWarmth:
    """Correction of the elastic wrench; offset (6,) N and N mm a kelvin since rest, gain (6,) a kelvin."""

    reference: float
    coldest: float
    warmest: float
    gain: Array
    offset: Array

    def corrected(self, elastic: Array, degrees: Degrees) -> Array:
        """(t, 6); as they are where temperature is not measured."""
        since_rest, since_reference = self._since(degrees)
        return np.asarray((elastic - np.outer(since_rest, self.offset)) * (1 + np.outer(since_reference, self.gain)))

    def inverse(self, wrench: Array, degrees: Degrees) -> Array:
        """Elastic wrench that `corrected` takes to `wrench`."""
        since_rest, since_reference = self._since(degrees)
        return np.asarray(wrench / (1 + np.outer(since_reference, self.gain)) + np.outer(since_rest, self.offset))

    def refined(self, elastic: Array, wrench: Array, degrees: Degrees, axes: npt.NDArray[np.bool_]) -> WrenchWarmth:
        """Offset and gain that take `elastic` nearest to `wrench`, on those axes; the others have none."""
        since_rest, since_reference = self._since(degrees)
        gain, offset = np.zeros(6), np.zeros(6)
        for i in np.flatnonzero(axes):
            columns = np.stack([elastic[:, i], elastic[:, i] * since_reference, -since_rest], axis=1)
            scale, slope, zero = np.linalg.lstsq(columns, wrench[:, i], rcond=None)[0]
            gain[i], offset[i] = slope / scale, zero / scale
        return replace(self, gain=gain, offset=offset)

    def _since(self, degrees: Degrees) -> tuple[Array, Array]:
        """Kelvin since rest was learned, and above the reference; 0 where not measured."""
        rest = np.where(np.isfinite(degrees.rest), degrees.rest, self.reference)
        return np.nan_to_num(degrees.now - rest), np.nan_to_num(degrees.now - self.reference)


def no_warmth(degrees: Degrees) -> WrenchWarmth:
    """Nothing to correct yet, about the log's mean temperature."""
    now = degrees.now
    return WrenchWarmth(float(now.mean()), float(now.min()), float(now.max()), np.zeros(6), np.zeros(6))
