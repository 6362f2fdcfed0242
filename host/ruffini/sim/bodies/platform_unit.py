"""A slab on a tray on springs: the slab's forces load the tray, the tray's motion carries slab and targets.

All is linear, so the tray adds B Q B^T to the slab's surface compliance (B: rigid motions of its nodes, Q: the tray's
compliance within one step), and what the sleeve remembers adds a rigid motion. The contact solver then sees one body,
and forces and moments balance exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.bodies.platform import Platform, Tray, rigid_modes
from ruffini.sim.contact import ContactSolver, Indenter, release
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.pose import Pose
from ruffini.sim.response import Response
from ruffini.sim.unit import FlatRig, TwinUnit

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MAX_SINK_M = 3e-3  # of the tray
MAX_STRAIN = 0.5  # of the slab, of its thickness, as on other slabs


class PlatformResponse:
    """A slab on a tray, in time (`response.Response`)."""

    moves_the_arm = False

    def __init__(self, slab: Response, modes: Array, platform: Platform) -> None:
        self._slab, self._modes, self.tray = slab, modes, Tray(platform)

    @property
    def surface(self) -> Array:
        return self._slab.surface + self.carried(self.tray.shift)

    def begin(self, duration_s: float) -> None:
        self._slab.begin(duration_s)
        self.tray.begin(duration_s)

    def carried(self, shift: Array) -> Array:
        """Displacement of the slab's nodes when the tray moves like that, (n, 3)."""
        return np.asarray((self._modes @ shift).reshape(-1, 3))

    def free_surface(self) -> Array:
        return self._slab.free_surface() + self.carried(self.tray.unloaded)

    def rows(self, nodes: Indices) -> Array:
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        return np.asarray(self._slab.rows(nodes) + (self._modes[dofs] @ self.tray.compliance) @ self._modes.T)

    def correct(self, nodal_force: Array, surface: Array) -> float:
        self.tray.load(self._modes.T @ nodal_force.ravel())
        return self._slab.correct(nodal_force, surface - self.carried(self.tray.shift))

    def commit(self) -> None:
        self._slab.commit()
        self.tray.commit()


@dataclass
class PlatformUnit(TwinUnit):
    """A slab whose `compliance` is its own, on a platform."""

    platform: Platform = field(kw_only=True)

    def response(self) -> PlatformResponse:
        """Slab and tray before anything ever loaded them."""
        x, y = np.meshgrid(self.model.node_x(), self.model.node_y())
        modes = rigid_modes(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])).reshape(-1, 6)
        return PlatformResponse(super().response(), modes, self.platform)

    def rig(self) -> PlatformRig:
        return PlatformRig(self)

    def solver(self, indenter: Indenter, response: Response | None = None) -> ContactSolver:
        """A contact with slab and tray as one: with their state `response`, or fresh."""
        friction = self.twin.unit.friction_1e3 * 1e-3
        return ContactSolver(self.model, response or self.response(), indenter, friction, give_m=MAX_SINK_M)


class PlatformRig(FlatRig):
    """Slab and tray in time. `displacement` is the slab's on its tray, `tray` where that stands."""

    def __init__(self, unit: PlatformUnit) -> None:
        super().__init__(unit)
        self._platform_unit, self._response = unit, unit.response()
        self._load = np.zeros(6)

    @property
    def displacement(self) -> Array:
        moved = self.solver.displacement if self.solver else self._response.surface
        return np.asarray(moved - self._response.carried(self._response.tray.shift))

    @property
    def tray(self) -> TrayPose:
        x, y, z, about_x, about_y, about_z = self._response.tray.shift.tolist()
        return TrayPose((x, y, z), (about_x, about_y, about_z))

    def take(self, indenter: Indenter) -> None:
        release(self._response, 0.0)
        self.solver, self._load = self._platform_unit.solver(indenter, self._response), np.zeros(6)

    def advance(self, pose: Pose) -> None:
        assert self.solver is not None
        self.solver.advance(pose, self.frame_s)
        thickness_m = self.unit.model.thickness_m
        sunk = -float(self.displacement[:, 2].min())
        if sunk > MAX_STRAIN * thickness_m:
            raise InputError(
                f"the slab is pressed {sunk * 1e3:.2f} mm into its tray, beyond this linear model, "
                f"which holds to {MAX_STRAIN * thickness_m * 1e3:.2f} mm: press less deep"
            )

    def load(self, wrench: Array) -> None:
        self.solver, self._load = None, np.array(wrench, dtype=float)
        tray = self._response.tray
        tray.begin(self.frame_s)
        tray.load(self._load)
        tray.commit()
        sunk = float(np.abs(tray.shift[:3]).max())
        if sunk > MAX_SINK_M:
            raise InputError(
                f"this load moves the tray by {sunk * 1e3:.1f} mm: it has {MAX_SINK_M * 1e3:.0f} mm of way"
            )

    def rest(self) -> None:
        self.solver, self._load = None, np.zeros(6)
        release(self._response, self.frame_s)

    def wrench(self) -> Array:
        return super().wrench() if self.solver else self._load
