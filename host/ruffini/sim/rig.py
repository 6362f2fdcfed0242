"""What every simulated body offers to stories, recordings, datasets and the live twin."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import Pose
from ruffini.sim.settings import TwinSettings

Array = npt.NDArray[np.float64]
States = npt.NDArray[np.uint8]


class Rig(Protocol):
    """One body and what loads it, one frame after the other; bodies with a memory keep it from touch to touch.

    Forces act ON the body. What a method or property returns is of the present frame: copy what is to stay.
    """

    frame_s: float
    """How long a frame lasts: by so much a body with a memory gets older in it. The camera's period until it is set."""

    @property
    def displacement(self) -> Array:
        """Of the nodes that the renderer shows, (n, 3) metres."""

    @property
    def tray(self) -> TrayPose | None:
        """Where the tray stands that carries the body; None = it has none."""

    def take(self, indenter: Indenter) -> None:
        """From now on this indenter is used; nothing touches yet."""

    def advance(self, pose: Pose) -> None:
        """One frame in which the indenter goes to `pose` in a straight line."""

    def load(self, wrench: Array) -> None:
        """One frame at whose end a rigid connector in the body's place carries this wrench, (6,) N and N m."""

    def rest(self) -> None:
        """One frame in which nothing touches."""

    def wrench(self) -> Array:
        """Force (N) and moment (N m) about the origin of the pad's frame, (6,)."""

    def nodal_force(self) -> Array:
        """Force (N) at the board's nodes, (n_y, n_x, 3)."""

    def nodal_displacement(self) -> Array:
        """Displacement (m) at the board's nodes, (n_y, n_x, 3)."""

    def nodal_state(self) -> States:
        """0 free, 1 sticks, 2 slips at the board's nodes, (n_y, n_x)."""


class Unit(Protocol):
    """One simulated sensor: a body and a camera."""

    @property
    def board(self) -> Board: ...

    @property
    def twin(self) -> TwinSettings: ...

    def rig(self) -> Rig:
        """The body before anything ever touched it."""

    def renderer(self) -> Renderer:
        """Its camera."""

    def at_rest(self) -> Array:
        """Displacement of the untouched surface, (n, 3)."""

    def body_toml(self) -> str:
        """The body's true numbers as a table [pad] for recordings."""
