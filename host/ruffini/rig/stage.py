"""The interface of motion stages: positions, guarded moves and a halt."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

Guard = Callable[[], None]  # raises where the move must not go on


class Place(NamedTuple):
    """Where the tip is, metres; z away from the pad."""

    x_m: float
    y_m: float
    z_m: float

    def plus(self, other: Place) -> Place:
        """Sum of both."""
        return Place(self.x_m + other.x_m, self.y_m + other.y_m, self.z_m + other.z_m)

    def minus(self, other: Place) -> Place:
        """From `other` to here."""
        return Place(self.x_m - other.x_m, self.y_m - other.y_m, self.z_m - other.z_m)

    def distance(self, other: Place) -> float:
        """Metres between both."""
        return float(np.linalg.norm(np.subtract(self, other)))

    def __str__(self) -> str:
        return f"x {1e3 * self.x_m:.2f}, y {1e3 * self.y_m:.2f}, z {1e3 * self.z_m:.2f} mm"


def no_guard() -> None:
    """A guard that never stops a move."""


class Stage(Protocol):
    """A machine in its own coordinates."""

    @property
    def name(self) -> str: ...

    def home(self) -> None:
        """Find its own zero by its switches."""

    def position(self) -> Place:
        """Its reported position."""

    def move(self, place: Place, speed_m_s: float, guard: Guard = no_guard) -> None:
        """In a straight line; returns when it stands there. `guard` is called all the time: where it raises, it halts.

        Raises
        ------
        RefusedError
            It is not homed, a limit was hit, or it says no.
        NoDeviceError
            It was unplugged, was reset, or does not arrive.
        """

    def halt(self) -> None:
        """Stand still as soon as it can, and be ready for a move after that."""

    def raise_by(self, height_m: float, speed_m_s: float) -> None:
        """Straight up from wherever it is, homed or not: the way out when nothing else goes; raises as `move`."""

    def close(self) -> None:
        """Close the device."""
