"""A story of touches, played frame by frame on one unit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.sim.contact import ContactSolver
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.pose import Pose
from ruffini.sim.programs import Load, Rest, Step
from ruffini.sim.rig import Rig, Unit
from ruffini.sim.unit import FlatRig

Array = npt.NDArray[np.float64]


class Told(Protocol):
    """What a recording wants to know of a frame."""

    @property
    def displacement(self) -> Array: ...

    @property
    def tray(self) -> TrayPose | None: ...

    @property
    def touch(self) -> int: ...

    @property
    def judged(self) -> bool: ...

    def wrench(self) -> Array: ...

    def pose_row(self) -> Array: ...

    def nodal_state(self) -> npt.NDArray[np.uint8]: ...

    def nodal_force(self) -> Array: ...

    def nodal_displacement(self) -> Array: ...


@dataclass(frozen=True)
class Moment:
    """The truth of one frame; `pose` is None where no indenter touches. The next moment changes it."""

    rig: Rig
    touch: int = -1
    pose: Pose | None = None
    judged: bool = False

    @property
    def displacement(self) -> Array:
        """(n, 3) metres at the surface nodes of the mechanics."""
        return self.rig.displacement

    @property
    def tray(self) -> TrayPose | None:
        """Where the tray stands, if there is one."""
        return self.rig.tray

    @property
    def solver(self) -> ContactSolver | None:
        """The contact with a flat pad, while something touches it."""
        return self.rig.solver if isinstance(self.rig, FlatRig) else None

    def wrench(self) -> Array:
        """Force (N) and moment (N m) about the pad's centre, (6,)."""
        return self.rig.wrench()

    def pose_row(self) -> Array:
        """x, y, depth (m), turn, roll and pitch (rad), NaN where nothing touches, (6,)."""
        return self.pose.row() if self.pose else np.full(6, np.nan)

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        """0 free, 1 sticks, 2 slips: the nearest node of the mechanics to each of the board's, (n_y, n_x)."""
        return self.rig.nodal_state()

    def nodal_force(self) -> Array:
        """Force (N) at the board's nodes, (n_y, n_x, 3)."""
        return self.rig.nodal_force()

    def nodal_displacement(self) -> Array:
        """Displacement (m) at the board's nodes, (n_y, n_x, 3)."""
        return self.rig.nodal_displacement()


def play(unit: Unit, story: Iterable[Step]) -> Iterator[Moment]:
    """One moment a frame. A moment's rig goes on with the next one: take what is needed first.

    Raises
    ------
    InputError
        An indenter leaves the pad, or the body cannot be loaded so.
    """
    rig, touch = unit.rig(), -1
    for step in story:
        if isinstance(step, Rest):
            for _ in range(step.n_frames):
                rig.rest()
                yield Moment(rig)
        elif isinstance(step, Load):
            for wrench, judged in zip(step.wrenches, step.judged, strict=True):
                rig.load(wrench)
                yield Moment(rig, judged=judged)
        else:
            touch += 1
            rig.take(step.indenter)
            for pose, judged in zip(step.poses, step.judged, strict=True):
                rig.advance(pose)
                yield Moment(rig, touch, pose, judged)
