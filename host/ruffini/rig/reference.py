"""The interface of references: wrenches with host times, range and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
NONE = np.full(6, np.nan)


class Reading(NamedTuple):
    """One sample: force (N) ON the pad and moment (N m) in the reference's own frame, NaN where it has no axis."""

    host_s: float  # host_clock.now() at which it was received
    wrench: Array  # (6,)
    is_saturated: bool = False


@dataclass(frozen=True)
class Facts:
    """Properties of a reference: range and standard uncertainty, (6,) N and N m, NaN for axes it lacks."""

    name: str
    full_scale: Array
    sigma: Array
    rate_hz: float
    unit: str = "N"  # what it counts in
    is_typed: bool = False  # by a person: it stands until another one is typed, and never falls silent

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that it measures."""
        return tuple(a for a, s in zip(AXES, self.sigma, strict=True) if not np.isnan(s))

    @classmethod
    def of_one_axis(
        cls, name: str, full_scale_n: float, sigma_n: float, rate_hz: float, unit: str, *, is_typed: bool = False
    ) -> Facts:
        """Of a cell that measures how hard the pad is pressed."""
        return cls(name, pressing(full_scale_n), pressing(sigma_n), rate_hz, unit, is_typed)


class Reference(Protocol):
    """A connected reference, read by one thread."""

    @property
    def facts(self) -> Facts: ...

    def read(self, timeout_s: float) -> list[Reading]:
        """The readings since the last call; waits for at least one.

        Raises
        ------
        NoDeviceError
            Nothing came in time, or the device is gone or reports a fault.
        InputError
            What came cannot be understood.
        """

    def close(self) -> None:
        """Close the device."""


def lost_packets(reference: Reference) -> int | None:
    """Packets without a reading so far, of a reference that numbers them (`n_lost`); else None."""
    return getattr(reference, "n_lost", None)


def pressing(value: float) -> Array:
    """(6,) with a value on z and NaN elsewhere."""
    out = NONE.copy()
    out[2] = value
    return out
