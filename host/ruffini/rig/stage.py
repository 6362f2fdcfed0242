"""The interface of motion stages: positions, guarded moves and a halt; and an axis that turns a tube under the tip."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from ruffini.errors import NoDeviceError

Guard = Callable[[], None]  # raises where the move must not go on


TURN_DEG_S, TURNED_DEG = 10.0, 0.05  # with the tip up; off by no more


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


class Rotary(NamedTuple):
    """An axis in degrees that turns a tube under the tip. It takes the place of x, which is the way round the tube.

    letter : its G-code word; radius_m : of the tube; x_m : where the machine's own x axis stays, above the tube's axis.
    """

    letter: str
    radius_m: float
    x_m: float

    def degrees(self, way_m: float) -> float:
        """Of a way round the tube."""
        return math.degrees(way_m / self.radius_m)

    def way_m(self, degrees: float) -> float:
        """Round the tube."""
        return math.radians(degrees) * self.radius_m


def moves(place: Place, speed_m_s: float, rotary: Rotary | None) -> list[str]:
    """Words of the G1 commands that lead to a place.

    With a tube each goes alone: firmwares disagree on what F means where degrees and millimetres move together, and
    the tip must be up before the machine's own x axis goes to its place.
    """
    x, y, z = (1e3 * v for v in place)
    feed = f"F{60e3 * speed_m_s:.1f}"
    if rotary is None:
        return [f"X{x:.4f} Y{y:.4f} Z{z:.4f} {feed}"]
    turn = f"{rotary.letter}{rotary.degrees(place.x_m):.4f} F{60 * rotary.degrees(speed_m_s):.1f}"
    return [f"Z{z:.4f} {feed}", turn, f"X{1e3 * rotary.x_m:.4f} Y{y:.4f} {feed}"]


def turning(degrees: Mapping[str, float]) -> str:
    """Words of the G1 command that turns axes."""
    return " ".join([*(f"{axis}{angle:.3f}" for axis, angle in degrees.items()), f"F{60 * TURN_DEG_S:.1f}"])


def check_turned(name: str, degrees: Mapping[str, float], reported: Mapping[str, float]) -> None:
    """Raises NoDeviceError if an axis does not stand where it was turned to."""
    for axis, angle in degrees.items():
        if abs(reported.get(axis, math.inf) - angle) > TURNED_DEG:
            raise NoDeviceError(f"{name} has not turned its axis {axis} to {angle:g} degrees: check [holder] axes")


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
        """In a straight line, with a `Rotary` in three; returns when it stands there.

        `guard` is called all the time: where it raises, the stage halts.

        Raises
        ------
        RefusedError
            It is not homed, a limit was hit, or it says no.
        NoDeviceError
            It was unplugged, was reset, or does not arrive.
        """

    def turn(self, degrees: Mapping[str, float], guard: Guard = no_guard) -> None:
        """Turn what is pressed, by the G-code words of its axes; returns when they stand there. As `move`."""

    def halt(self) -> None:
        """Stand still as soon as it can, and be ready for a move after that."""

    def raise_by(self, height_m: float, speed_m_s: float) -> None:
        """Straight up from wherever it is, homed or not: the way out when nothing else goes; raises as `move`."""

    def close(self) -> None:
        """Close the device."""
