"""Indenters on the pad: unilateral contact with Coulomb friction along a loading path.

Unknowns are tractions that are bilinear between the surface nodes (`ruffini.sim.surface`), so the
forces are exact. The surface touches the indenter where it is after it moved sideways. Pressure acts along z at small
strain, along the indenter's normal at finite strain. Force ON the pad, z out of it. An elastic indenter gives way by
its own compliance (`indenters.body`); what the pad has behind its surface is in `response`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.complementarity import in_discs, largest_eigenvalue, nonnegative
from ruffini.sim.indenters import Indenter
from ruffini.sim.indenters.body import body_of
from ruffini.sim.indenters.face import ElasticFace
from ruffini.sim.pad import BLAS, PadModel
from ruffini.sim.pose import Pose, rigid_step, surface_height
from ruffini.sim.response import LinearResponse, Response
from ruffini.sim.surface import hat_shares, on_grid

__all__ = ["ContactSolver", "Indenter", "Pose", "advance_together"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MAX_STEP_M = 0.1e-3  # of the indenter's path between two equilibria: friction follows the path
TOLERANCE = 1e-5  # change of the forces between two rounds, of the largest force
MAX_ROUNDS = 120  # of pressure and friction in turn, in one correction
UNDAMPED_ROUNDS = 6
PATIENT_ROUNDS = 24  # then pressure and friction go half the way only: under large shear they may chase each other
RESIDUE = 1e-7  # of the largest pressure: what going half the way leaves of a node that has let go
MAX_CORRECTIONS = 40  # of a response that is not linear, in one increment
CORRECTED_M = 3e-8  # lacking displacement that is equilibrium
OPEN_GAP_M = 1e-9  # penetration outside the candidates that is rounding
SLOPE_STEP_M = 5e-6  # over which an indenter's slope is taken
STEEPEST = 1.0  # slope of a side beside the surface that touches
FREE, STICKS, SLIPS = 0, 1, 2


@dataclass
class ContactSolver:
    """Quasi-static contact of one indenter; `advance` moves it to the next pose.

    Parameters
    ----------
    model : the pad.
    compliance : its `surface_compliance`, or a response with more behind it.
    indenter : Indenter
    friction : float
        Coulomb coefficient mu.
    give_m : float
        Way by which what carries the pad may give on top of the pad's own largest depth.
    """

    model: PadModel
    compliance: Array | Response
    indenter: Indenter
    friction: float
    give_m: float = 0.0
    response: Response = field(init=False)
    hat_force: Array = field(init=False)  # (n, 3) N, of each node's hat
    displacement: Array = field(init=False)  # (n, 3) m, of the surface nodes
    _pose: Pose | None = field(init=False, default=None)
    _ended: Array = field(init=False)  # hat forces when the last increment ended
    _guess: Array = field(init=False)  # where the rounds of pressure and friction start

    def __post_init__(self) -> None:
        x, y = np.meshgrid(self.model.node_x(), self.model.node_y())
        self._place = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        self._shares = hat_shares(self.model)
        self.hat_force = np.zeros((len(self._place), 3))
        self._ended = self._guess = self.hat_force.copy()
        self._normal = np.tile([0.0, 0.0, 1.0], (len(self._place), 1))  # out of the pad, where it is touched
        self._body = ElasticFace(body_of(self.indenter)) if self.indenter.material else None
        linear = isinstance(self.compliance, np.ndarray)
        self.response = LinearResponse(self.compliance) if linear else self.compliance  # type: ignore[arg-type,assignment]
        self.displacement = self.response.surface.copy()

    @property
    def nodal_force(self) -> Array:
        """Force at each node of the pad model's surface, (n, 3), newtons."""
        return np.asarray(self._shares @ self.hat_force)

    @property
    def contact_state(self) -> npt.NDArray[np.uint8]:
        """FREE, STICKS or SLIPS at each node of the pad model's surface, (n,)."""
        along = (self.hat_force * self._normal).sum(axis=1)
        across = np.linalg.norm(self.hat_force - along[:, None] * self._normal, axis=1)
        slips = across >= -self.friction * along * (1 - 1e-9)
        return np.where(along < 0, np.where(slips, SLIPS, STICKS), FREE).astype(np.uint8)

    def forces_on_grid(self, n_x: int, n_y: int) -> Array:
        """Nodal forces of the same tractions on another grid over the pad, (n_y, n_x, 3), newtons."""
        return on_grid(self.model, self.hat_force, n_x, n_y)

    def advance(self, pose: Pose, duration_s: float = 0.0) -> None:
        """Move the indenter in a straight line; stick and slip follow from where it was before.

        Raises
        ------
        InputError
            The indenter is beside the pad, or deeper than the model of pad and ball can go.
        RuffiniError
            No equilibrium was found.
        """
        advance_together([self], [pose], duration_s)

    def _way(self, pose: Pose) -> tuple[Pose, int]:
        """Where the way to a pose starts, and in how many increments it is gone."""
        self._check(pose)
        start = self._pose or Pose(pose.x_m, pose.y_m, 0.0, *pose.row()[3:].tolist())
        change = np.abs(pose.row() - start.row())
        change[3:] *= self.indenter.radius_m
        return start, max(1, int(np.ceil(change.max() / MAX_STEP_M - 1e-6)))

    def _check(self, pose: Pose) -> None:
        half = (self.model.size_x_m / 2, self.model.size_y_m / 2)
        if abs(pose.x_m) > half[0] or abs(pose.y_m) > half[1]:
            raise InputError(
                f"the indenter at ({pose.x_m * 1e3:.2f}, {pose.y_m * 1e3:.2f}) mm is beside the pad, "
                f"which ends at +-({half[0] * 1e3:.2f}, {half[1] * 1e3:.2f}) mm"
            )
        deepest = 0.5 * self.model.thickness_m
        if self.indenter.shape in ("sphere", "cylinder"):
            deepest = min(deepest, 0.8 * self.indenter.radius_m)
        deepest += self.give_m
        if pose.depth_m > deepest:
            raise InputError(
                f"depth {pose.depth_m * 1e3:.2f} mm is beyond this model, "
                f"which holds to {deepest * 1e3:.2f} mm here: press less deep"
            )

    def _begin(self, before: Pose, after: Pose) -> None:
        """Another increment: which nodes may touch, and where they would go with the indenter."""
        place = self._place + self.displacement
        self._near = np.flatnonzero(self._gap(after, place) < 0.3 * after.depth_m)
        self._is_patient = False
        self._guess, self._ended = 2 * self.hat_force - self._ended, self.hat_force.copy()  # a press goes on as it went
        self._after, self._target = after, self.displacement + rigid_step(self.indenter, before, after, place)
        # A node sticks from where it touches: the way of an inclined face down to it is no slip along that face.
        apart = np.maximum(self._shares.T @ (self._gap(before, place) - self.displacement[:, 2]), 0.0)
        self._apart = np.where(self.hat_force.any(axis=1), 0.0, apart)

    def _touch(self, free: Array) -> bool:
        """Equilibrium with the linear picture of a pad, unloaded at `free` (n, 3); whether it was found."""
        after = self._after
        if after.depth_m <= 0 or not self._near.size:
            self.hat_force[:], self.displacement = 0.0, free.copy()
            if self._body:
                self._body.release()
            return True
        while True:  # the pad may bulge up against the indenter outside the first guess
            near = self._near
            force, rows, nodal, is_found = self._balance(near, after, free)
            self._is_patient |= not is_found
            displacement = free + (nodal.ravel() @ rows).reshape(-1, 3)
            over = displacement[:, 2] - self._gap(after, self._place + displacement)
            if self._body:
                over -= self._body.pushed(near, force, after, self._place)[:, 2]
            through = np.flatnonzero(self._shares.T @ over > OPEN_GAP_M)
            self._near = np.union1d(near, through)
            if len(self._near) == len(near):
                break
        self.hat_force[:] = 0.0
        self.hat_force[near] = force
        self.displacement, self._guess = displacement, self.hat_force
        return is_found

    def _pushed(self) -> Array:
        """What this contact's forces alone do to the surface in the linear picture, (n, 3)."""
        nodal = self.nodal_force
        nodes = np.flatnonzero(nodal.any(axis=1))
        return np.asarray((nodal[nodes].ravel() @ self.response.rows(nodes)).reshape(-1, 3))

    def _end(self) -> None:
        near = self._near
        if self._body and self._after.depth_m > 0 and near.size:
            self._body.push(near, self.hat_force[near], self._after, self._place)
        self._pose = self._after

    def _gap(self, pose: Pose, place: Array) -> Array:
        """Height of the indenter's surface over the undeformed pad's surface at `place` (n, 2 or 3)."""
        return surface_height(self.indenter, pose, place[:, :2])

    def _frames(self, slope: Array) -> Array:
        """Axes (n, 3, 3) of the forces where the indenter has these slopes (n, 2): two along it, one normal."""
        steep = np.hypot(slope[:, 0], slope[:, 1])
        gx, gy = (slope * np.minimum(1.0, STEEPEST / np.maximum(steep, STEEPEST))[:, None]).T
        one, none = np.ones_like(gx), np.zeros_like(gx)
        normal = np.column_stack([-gx, -gy, one]) / np.sqrt(1 + gx**2 + gy**2)[:, None]
        first = np.column_stack([one, none, gx]) / np.sqrt(1 + gx**2)[:, None]
        return np.stack([first, np.cross(normal, first), normal], axis=1)

    def _slope(self, pose: Pose, place: Array) -> Array:
        """Slope of the indenter's surface along x and y at `place` (n, 2)."""
        steps = SLOPE_STEP_M * np.eye(2)
        rises = [self._gap(pose, place + step) - self._gap(pose, place - step) for step in steps]
        return np.column_stack(rises) / (2 * SLOPE_STEP_M)

    def _balance(self, near: Indices, pose: Pose, free: Array) -> tuple[Array, Array, Array, bool]:
        """Equilibrium of the candidates: their hat forces, the response's rows of the nodes that these load, the nodal
        forces; found?

        Pressure and friction are solved in turn, each exactly for the other, until they agree.
        """
        columns = self._shares[:, near]
        nodes = np.unique(columns.indices)
        shares = sp.csr_matrix(columns[nodes])
        to_hats = sp.csr_matrix(shares.T)
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        rows = self.response.rows(nodes)
        local = rows[:, dofs]
        half = (to_hats @ local.reshape(len(nodes), -1)).reshape(3 * len(near), -1)
        c = (to_hats @ half.T.reshape(len(nodes), -1)).reshape(len(near), 3, len(near), 3)
        target = to_hats @ (self._target - free)[nodes]
        target[:, 2] += self._apart[near]
        if self._body:
            c += self._body.compliance(near, pose, self._place)
            target -= self._body.displacement(near, pose, self._place)
        place, rest = self._place[nodes, :2] + free[nodes, :2], to_hats @ free[nodes]
        moved, change = self.displacement[nodes, :2] - free[nodes, :2], np.inf
        slope = np.zeros((len(near), 2))
        if self.response.moves_the_arm:
            slope = to_hats @ self._slope(pose, place + moved)
        frame = self._frames(slope)
        if slope.any():
            c = np.einsum("iab,ibjd,jed->iaje", frame, c, frame, optimize=True)
        stick = np.einsum("iab,ib->ia", frame[:, :2], target)
        unloaded = np.einsum("ib,ib->i", frame[:, 2], rest)
        normal, cross = c[:, 2, :, 2], c[:, 2, :, :2].reshape(len(near), -1)
        tangent = c[:, :2, :, :2].reshape(2 * len(near), -1)
        step = 1 / largest_eigenvalue(tangent)
        guess = np.einsum("iab,ib->ia", frame, self._guess[near])
        pressure, shear = np.maximum(-guess[:, 2], 0.0), guess[:, :2]
        for i in range(MAX_ROUNDS):
            last_pressure, last_shear = pressure, shear
            nodal = shares @ np.einsum("iab,ia->ib", frame, np.column_stack([shear, -pressure]))
            damping = 1.0 if i < UNDAMPED_ROUNDS else 0.5  # nodes at an edge may swing about it
            moved = moved + damping * ((local @ nodal.ravel()).reshape(-1, 3)[:, :2] - moved)
            # The indenter's tangent plane there: n u <= n_z (gap - slope (u_x, u_y)) for the whole displacement u.
            aside = to_hats @ moved + rest[:, :2]
            gap = frame[:, 2, 2] * (to_hats @ self._gap(pose, place + moved) - (slope * aside).sum(axis=1))
            pressure = nonnegative(normal, cross @ shear.ravel() + unloaded - gap, pressure > 0)
            wanted = stick.ravel() + cross.T @ pressure
            limit = self.friction * pressure
            largest = float(limit.max())
            inner = np.clip(0.01 * change, 0.02 * TOLERANCE * largest, 0.01 * largest)
            shear = in_discs(tangent, wanted, limit, shear, step, float(inner))
            if i >= PATIENT_ROUNDS or self._is_patient:
                pressure, shear = (pressure + last_pressure) / 2, (shear + last_shear) / 2
            change = max(np.abs(pressure - last_pressure).max(), np.abs(shear - last_shear).max())
            is_found = bool(change <= TOLERANCE * pressure.max())
            if is_found:
                break
        self._normal[near] = frame[:, 2]
        force = np.einsum("iab,ia->ib", frame, np.column_stack([shear, -pressure]))
        force[pressure < RESIDUE * pressure.max()] = 0.0
        return force, rows, np.asarray(shares @ force), is_found


def advance_together(solvers: Sequence[ContactSolver], poses: Sequence[Pose], duration_s: float = 0.0) -> None:
    """Move indenters that share one response, each in a straight line, in the same increments.

    Raises
    ------
    InputError
        An indenter is beside the pad, or deeper than the model can go.
    RuffiniError
        No equilibrium was found.
    """
    ways = [solver._way(pose) for solver, pose in zip(solvers, poses, strict=True)]
    n_steps, response = max(n for _, n in ways), solvers[0].response
    with BLAS.limit(limits=1):
        for i in range(n_steps):
            response.begin(duration_s / n_steps)
            for solver, pose, (start, _) in zip(solvers, poses, ways, strict=True):
                solver._begin(start.towards(pose, i / n_steps), start.towards(pose, (i + 1) / n_steps))
            _equilibrium(solvers, response)
            response.commit()
            for solver in solvers:
                solver._end()
    for solver, pose in zip(solvers, poses, strict=True):
        solver._pose = pose


def release(response: Response, duration_s: float) -> None:
    """Let a pad alone for a time: nothing touches it."""
    response.begin(duration_s)
    _equilibrium([], response)
    response.commit()


def _equilibrium(solvers: Sequence[ContactSolver], response: Response) -> None:
    """Contacts with the linear picture of the pad, each in the others' field, and its correction, in turn."""
    lack, settled = np.inf, [False]
    for _ in range(MAX_CORRECTIONS):
        free = response.free_surface()
        settled = []
        for solver in solvers:
            others = [other._pushed() for other in solvers if other is not solver]
            settled.append(solver._touch(free + np.sum(others, axis=0) if others else free))
        surface = solvers[-1].displacement if solvers else free
        apart = max((float(np.abs(solver.displacement - surface).max()) for solver in solvers), default=0.0)
        force = sum((solver.nodal_force for solver in solvers), start=np.zeros_like(free))
        lack = max(apart, response.correct(force, surface))
        for solver in solvers:
            solver.displacement = surface.copy()
        if lack <= CORRECTED_M and all(settled):
            return
    if not all(settled):
        pose = solvers[settled.index(False)]._after
        raise RuffiniError(
            f"the simulated contact at {pose} found no equilibrium: press less deep or with less friction"
        )
    raise RuffiniError(
        f"the simulated pad found no equilibrium in {MAX_CORRECTIONS} corrections ({lack * 1e6:.2f} um are lacking): "
        "press less deep, or with a rounder indenter"
    )
