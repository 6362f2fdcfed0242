"""A holder that turns a fingertip under the tip of a stage: set by a person, or two axes of the stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ruffini.rig.stage import Place

Tilt = tuple[float, float]  # roll and pitch of the tip's axis in the fingertip's axes, degrees
UPRIGHT: Tilt = (0.0, 0.0)


class Holder(NamedTuple):
    """Its outer axis is the stage's x and turns by -roll, the inner one is the fingertip's y and turns by -pitch.

    above_m : middle of the fingertip's sphere above the point in which the axes meet. axes : G-code words of the outer
    and the inner one, with a - if it turns the other way; none: a person sets them.
    """

    above_m: float
    axes: tuple[str, ...] = ()

    def degrees(self, tilt_deg: Tilt) -> dict[str, float]:
        """Of each of the stage's axes."""
        turns = zip(self.axes, tilt_deg, strict=False)
        return {axis[-1]: (angle if axis[0] == "-" else 0.0 - angle) for axis, angle in turns}

    def rise_m(self, tilts_deg: Sequence[Tilt]) -> float:
        """By how much the fingertip may come up, at most, while it turns from one of these tilts to another."""
        lowest = min((np.prod(np.cos(np.deg2rad(tilt))) for tilt in tilts_deg), default=1.0)
        return float(abs(self.above_m) * (1 - lowest))

    def aside(self, tilt_deg: Tilt) -> Place:
        """By how far the middle of the sphere moves from where it is upright, in the stage's axes; z is measured."""
        roll, pitch = np.deg2rad(tilt_deg)
        return Place(float(-self.above_m * np.sin(pitch)), float(self.above_m * np.sin(roll) * np.cos(pitch)), 0.0)


def told(tilt_deg: Tilt) -> str:
    """For a person at the holder."""
    outer, inner = (0.0 - angle for angle in tilt_deg)  # no -0
    return f"outer axis {outer:+g}, inner axis {inner:+g} degrees"
