"""A whole bench that is not there: twin as camera, what presses it, emulated reference below it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError
from ruffini.rig.emulated_machine import HOME_PLACE, EmulatedMachine
from ruffini.rig.emulated_references import FULL_SCALE, NO_MOUNT, SIGMA, EmulatedNetworkCell, Mount
from ruffini.rig.frame_clock import FrameClock
from ruffini.rig.program import Tool
from ruffini.rig.stage import Place
from ruffini.sim.indenters import Indenter, Material
from ruffini.sim.optics.settings import ShapeSettings
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import States, TwinServer

Array = npt.NDArray[np.float64]

__all__ = ["FULL_SCALE", "MAX_FORCE_N", "ORIGIN", "SIGMA", "Hanging", "PressedTwin", "build_twin_bench"]

ORIGIN = Place(HOME_PLACE.x_m + 0.002, HOME_PLACE.y_m - 0.001, HOME_PLACE.z_m - 0.004)  # of the pad in the machine
MAX_FORCE_N = 15.0
LEAST_FRAME_S = 1e-4
Load = Pose | Array | None  # the indenter there, a wrench on the connector, or nothing


class Loader(Protocol):
    """What presses a twin."""

    def load(self, wrench: Array) -> Load:
        """Now; `wrench` is what the body felt in the frame before."""


class Hanging:
    """An indenter that hangs on a machine."""

    def __init__(self, machine: EmulatedMachine, unit: Unit, indenter: Indenter) -> None:
        self._machine, self._shape, self._radius_m = machine, unit.twin.shape, indenter.radius_m

    def load(self, wrench: Array) -> Load:
        place = self._machine.place().minus(ORIGIN)
        depth_m = surface_m(self._shape, self._radius_m, place.x_m, place.y_m) - place.z_m
        return Pose(place.x_m, place.y_m, depth_m) if depth_m > 0 else None


def surface_m(shape: ShapeSettings, tip_radius_m: float, x_m: float, y_m: float) -> float:
    """Height of a ball's lowest point where it first touches the undeformed body, from the top; 0 on flat ones."""
    if shape.kind != "dome":
        return 0.0  # a tube is turned under the tip: x is the way round it
    reach_m = shape.radius_um * 1e-6 + tip_radius_m
    return float(np.sqrt(max(reach_m**2 - x_m**2 - y_m**2, 0.0)) - reach_m)


def along_the_tool(unit: Unit, pose: Pose, wrench: Array) -> Array:
    """A wrench with its force in the tool's axes, z out of the body: on a tube the radius is not the frame's z."""
    shape = unit.twin.shape
    if shape.kind != "tube":
        return wrench
    angle = pose.x_m / (shape.radius_um * 1e-6)
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    return np.array([wrench[:3] @ [-out[1], out[0], 0.0], wrench[2], wrench[:3] @ out, 0.0, 0.0, 0.0])


class PressedTwin:
    """Frames of a twin under a loader; keeps the true wrench of the newest, and tells who listens.

    A busy computer makes fewer frames than the camera has: the body gets older by the time that went by.
    """

    def __init__(self, unit: Unit, indenter: Indenter, loader: Loader) -> None:
        self.unit, self.loader = unit, loader
        self._rig, self._indenter, self._is_free = unit.rig(), indenter, True
        self.wrench = np.zeros(6)
        self._last_s = host_clock.now()
        self.listeners: list[Callable[[int, Array], None]] = []  # told frame and wrench, when the camera has the frame

    def mount(self, tool: Tool) -> None:
        """Another indenter, from the next touch on."""
        self._indenter = Indenter(tool.shape, tool.radius_m, Material.of_shore_a(tool.shore_a))

    def states(self, frame: int) -> States | None:
        before, now = self._rig.displacement.copy(), host_clock.now()
        self._rig.frame_s, self._last_s = max(now - self._last_s, LEAST_FRAME_S), now
        load = self.loader.load(self.wrench)
        with contextlib.suppress(InputError):  # deeper than the body's model goes: it stays as it was
            self._take(load)
        self.wrench = self._felt(load)
        return self._rig.displacement, before, self._rig.tray

    def tell(self, frame: int) -> None:
        """The camera has this frame now: so do the references have its wrench."""
        for listener in self.listeners:
            listener(frame, self.wrench)

    def _take(self, load: Load) -> None:
        if load is None:
            self._rig.rest()
            self._is_free = True
        elif isinstance(load, Pose):
            if self._is_free:  # each touch starts fresh: nothing sticks to earlier ones
                self._rig.take(self._indenter)
                self._is_free = False
            self._rig.advance(load)
        else:
            self._rig.load(load)
            self._is_free = True

    def _felt(self, load: Load) -> Array:
        if load is None:
            return np.zeros(6)
        wrench = self._rig.wrench().copy()
        return along_the_tool(self.unit, load, wrench) if isinstance(load, Pose) else wrench


class TwinBench(NamedTuple):
    """Its parts, to be entered in this order."""

    twin: PressedTwin
    server: TwinServer
    cell: EmulatedNetworkCell


def build_twin_bench(
    unit: Unit, indenter: Indenter, loader: Loader, camera: Path, seed: int, *, rate_hz: float = 10.0,
    mount: Mount = NO_MOUNT, clock: FrameClock | None = None,
) -> TwinBench:  # fmt: skip
    """A bench whose camera is the UNIX socket `camera`; `rate_hz` is what its reference says of itself.

    With a `clock`, which the caller lends to the host, a camera in lockstep gets its frames by simulated time.
    """
    twin = PressedTwin(unit, indenter, loader)
    server = TwinServer(unit.renderer(), twin, Scenario(seed=seed), camera)
    server.after_sending = twin.tell
    server.clock = clock
    cell = EmulatedNetworkCell(rate_hz, seed, mount)
    twin.listeners.append(cell.measure)
    return TwinBench(twin, server, cell)
