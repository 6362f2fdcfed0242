"""Rigid indenters on the pad: unilateral contact with Coulomb friction along a loading path.

Unknowns are tractions that are bilinear between the surface nodes (`ruffini.sim.surface`), so the
forces are exact. The surface touches the indenter where it is after it moved sideways. Force ON the
pad, z out of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.pad import BLAS, PadModel
from ruffini.sim.surface import hat_shares, on_grid

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SHAPES = ("sphere", "flat")
MAX_STEP_M = 0.1e-3  # of the indenter's path between two equilibria: friction follows the path
STEEP = 0.95  # part of a sphere's radius beyond which its side goes on straight
TOLERANCE = 1e-5  # change of the forces between two rounds, of the largest force
MAX_ROUNDS = 80
UNDAMPED_ROUNDS = 6
MAX_GRADIENT_STEPS = 600
OPEN_GAP_M = 1e-9  # penetration outside the candidates that is rounding


@dataclass(frozen=True)
class Indenter:
    """A ball ("sphere") or a round punch with a flat face and a 45 degree flank ("flat")."""

    shape: str
    radius_m: float

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise InputError(f"unknown indenter {self.shape!r}: {' or '.join(SHAPES)}")
        if not self.radius_m > 0:
            raise InputError(f"the indenter's radius must be positive, got {self.radius_m} m")

    def height(self, r: Array) -> Array:
        """Height of its surface above its lowest point at distance r from the axis."""
        if self.shape == "flat":
            return np.maximum(r - self.radius_m, 0.0)
        edge = STEEP * self.radius_m
        slope = STEEP / np.sqrt(1 - STEEP**2)
        round_part = self.radius_m - np.sqrt(self.radius_m**2 - np.minimum(r, edge) ** 2)
        return np.asarray(round_part + slope * np.maximum(r - edge, 0.0))


@dataclass(frozen=True)
class Pose:
    """Where the indenter is: axis (x, y), depth of its lowest point below the surface, turn about z."""

    x_m: float
    y_m: float
    depth_m: float
    turn_rad: float = 0.0

    def towards(self, end: Pose, part: float) -> Pose:
        """The pose at `part` (0 to 1) of the straight way to `end`."""
        return Pose(
            self.x_m + part * (end.x_m - self.x_m),
            self.y_m + part * (end.y_m - self.y_m),
            self.depth_m + part * (end.depth_m - self.depth_m),
            self.turn_rad + part * (end.turn_rad - self.turn_rad),
        )


@dataclass
class ContactSolver:
    """Quasi-static contact of one indenter; `advance` moves it to the next pose.

    Parameters
    ----------
    model, compliance : the pad and its `surface_compliance`.
    indenter : Indenter
    friction : float
        Coulomb coefficient mu.
    """

    model: PadModel
    compliance: Array
    indenter: Indenter
    friction: float
    hat_force: Array = field(init=False)  # (n, 3) N, of each node's hat
    displacement: Array = field(init=False)  # (n, 3) m, of the surface nodes
    _pose: Pose | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        x, y = np.meshgrid(self.model.node_x(), self.model.node_y())
        self._place = np.column_stack([x.ravel(), y.ravel()])
        self._shares = hat_shares(self.model)
        self.hat_force = np.zeros((len(self._place), 3))
        self.displacement = np.zeros((len(self._place), 3))

    @property
    def nodal_force(self) -> Array:
        """Force at each node of the pad model's surface, (n, 3), newtons."""
        return np.asarray(self._shares @ self.hat_force)

    def forces_on_grid(self, n_x: int, n_y: int) -> Array:
        """Nodal forces of the same tractions on another grid over the pad, (n_y, n_x, 3), newtons."""
        return on_grid(self.model, self.hat_force, n_x, n_y)

    def advance(self, pose: Pose) -> None:
        """Move the indenter in a straight line; stick and slip follow from where it was before.

        Raises
        ------
        InputError
            The indenter is beside the pad, or deeper than a linear model of pad and ball can go.
        RuffiniError
            No equilibrium was found.
        """
        self._check(pose)
        start = self._pose or Pose(pose.x_m, pose.y_m, 0.0, pose.turn_rad)
        way = np.abs([pose.x_m - start.x_m, pose.y_m - start.y_m, pose.depth_m - start.depth_m])
        arc = abs(pose.turn_rad - start.turn_rad) * self.indenter.radius_m
        n_steps = max(1, int(np.ceil(max(way.max(), arc) / MAX_STEP_M - 1e-6)))
        before = start
        with BLAS.limit(limits=1):
            for i in range(n_steps):
                after = start.towards(pose, (i + 1) / n_steps)
                self._step(before, after)
                before = after
        self._pose = pose

    def _check(self, pose: Pose) -> None:
        half = (self.model.size_x_m / 2, self.model.size_y_m / 2)
        if abs(pose.x_m) > half[0] or abs(pose.y_m) > half[1]:
            raise InputError(
                f"the indenter at ({pose.x_m * 1e3:.2f}, {pose.y_m * 1e3:.2f}) mm is beside the pad, "
                f"which ends at +-({half[0] * 1e3:.2f}, {half[1] * 1e3:.2f}) mm"
            )
        deepest = 0.5 * self.model.thickness_m
        if self.indenter.shape == "sphere":
            deepest = min(deepest, 0.8 * self.indenter.radius_m)
        if pose.depth_m > deepest:
            raise InputError(
                f"depth {pose.depth_m * 1e3:.2f} mm is beyond this linear model, "
                f"which holds to {deepest * 1e3:.2f} mm here: press less deep"
            )

    def _step(self, before: Pose, after: Pose) -> None:
        near = np.flatnonzero(self._gap(after, self._place + self.displacement[:, :2]) < 0.3 * after.depth_m)
        if after.depth_m <= 0 or not near.size:
            self.hat_force[:], self.displacement[:] = 0.0, 0.0
            return
        target = self._stick_target(before, after)
        while True:  # the pad may bulge up against the indenter outside the first guess
            force, nodes, nodal = self._balance(near, after, target)
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            displacement = (nodal.ravel() @ self.compliance[dofs]).reshape(-1, 3)
            over = displacement[:, 2] - self._gap(after, self._place + displacement[:, :2])
            through = np.flatnonzero(self._shares.T @ over > OPEN_GAP_M)
            grown = np.union1d(near, through)
            if len(grown) == len(near):
                break
            near = grown
        self.hat_force[:] = 0.0
        self.hat_force[near] = force
        self.displacement = displacement

    def _gap(self, pose: Pose, place: Array) -> Array:
        """Height of the indenter's surface over the undeformed pad's surface at `place`."""
        r = np.hypot(place[:, 0] - pose.x_m, place[:, 1] - pose.y_m)
        return np.asarray(self.indenter.height(r) - pose.depth_m)

    def _stick_target(self, before: Pose, after: Pose) -> Array:
        """Tangential displacement (n, 2) of nodes that would follow the indenter rigidly in this step."""
        turn = after.turn_rad - before.turn_rad
        arm = self._place + self.displacement[:, :2] - (before.x_m, before.y_m)
        shift = np.array([after.x_m - before.x_m, after.y_m - before.y_m])
        swing = turn * np.column_stack([-arm[:, 1], arm[:, 0]])
        return np.asarray(self.displacement[:, :2] + shift + swing)

    def _balance(self, near: Indices, pose: Pose, target: Array) -> tuple[Array, Indices, Array]:
        """Equilibrium of the candidates: their hat forces, the nodes that these load, the nodal forces.

        Pressure and friction are solved in turn, each exactly for the other, until they agree.
        """
        columns = self._shares[:, near]
        nodes = np.unique(columns.indices)
        shares = sp.csr_matrix(columns[nodes])
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        local = self.compliance[np.ix_(dofs, dofs)]
        spread = sp.kron(shares, sp.identity(3), format="csr")
        c = np.asarray(spread.T @ (spread.T @ local).T).reshape(len(near), 3, len(near), 3)
        normal, cross = c[:, 2, :, 2], c[:, 2, :, :2].reshape(len(near), -1)
        tangent = c[:, :2, :, :2].reshape(2 * len(near), -1)
        step = 1 / _largest_eigenvalue(tangent)
        stick = shares.T @ target[nodes]
        place = self._place[nodes]
        pressure, shear = np.maximum(-self.hat_force[near, 2], 0.0), self.hat_force[near, :2].copy()
        moved, change = self.displacement[nodes, :2], np.inf
        for i in range(MAX_ROUNDS):
            last_pressure, last_shear = pressure, shear
            nodal = shares @ np.column_stack([shear, -pressure])
            damping = 1.0 if i < UNDAMPED_ROUNDS else 0.5  # nodes at an edge may swing about it
            moved = moved + damping * ((local @ nodal.ravel()).reshape(-1, 3)[:, :2] - moved)
            gap = shares.T @ self._gap(pose, place + moved)
            pressure = _nonnegative(normal, cross @ shear.ravel() - gap, pressure > 0)
            wanted = stick.ravel() + cross.T @ pressure
            limit = self.friction * pressure
            largest = float(limit.max())
            inner = np.clip(0.01 * change, 0.02 * TOLERANCE * largest, 0.01 * largest)
            shear = _in_discs(tangent, wanted, limit, shear, step, float(inner))
            change = max(np.abs(pressure - last_pressure).max(), np.abs(shear - last_shear).max())
            if change <= TOLERANCE * pressure.max():
                force = np.column_stack([shear, -pressure])
                return force, nodes, np.asarray(shares @ force)
        raise RuffiniError(
            f"the simulated contact at {pose} found no equilibrium in {MAX_ROUNDS} rounds: "
            "press less deep or with less friction"
        )


def _largest_eigenvalue(matrix: Array) -> float:
    """An upper estimate of a positive definite matrix's largest eigenvalue, by power iteration."""
    v = np.ones(len(matrix))
    for _ in range(30):
        v = matrix @ v
        v /= np.linalg.norm(v)
    return float(np.linalg.norm(matrix @ v)) * 1.05


def _nonnegative(matrix: Array, right: Array, active: npt.NDArray[np.bool_]) -> Array:
    """p >= 0 with matrix p - right >= 0 and complementary, for a positive definite matrix.

    Primal-dual active set; when that cycles, the non-negative least squares of the Cholesky factor.
    """
    scale = float(np.abs(right).max())
    active = active if active.any() else right > 0
    for _ in range(40):
        p = np.zeros(len(right))
        if active.any():
            p[active] = np.linalg.solve(matrix[np.ix_(active, active)], right[active])
        lack = right - matrix @ p  # > 0: the surface would go through
        wanted = (active & (p > 0)) | (~active & (lack > 1e-9 * scale))
        if (wanted == active).all():
            return p
        active = wanted
    from scipy.optimize import nnls

    upper = np.linalg.cholesky(matrix).T
    p, _ = nnls(upper, np.linalg.solve(upper.T, right))
    return np.asarray(p)


def _in_discs(matrix: Array, wanted: Array, radius: Array, start: Array, step: float, tolerance: float) -> Array:
    """Minimise t.A t / 2 - wanted.t with |t_i| <= radius_i: accelerated projected gradient.

    Ends when no component changes by more than `tolerance` in a step.
    """
    loaded = np.flatnonzero(radius > 0)
    out = np.zeros_like(start)
    if loaded.size < len(radius):
        both = (2 * loaded[:, None] + np.arange(2)).ravel()
        part = matrix[np.ix_(both, both)]
        if loaded.size:
            out[loaded] = _in_discs(part, wanted[both], radius[loaded], start[loaded], step, tolerance)
        return out

    def project(t: Array) -> Array:
        length = np.hypot(t[:, 0], t[:, 1])
        return np.asarray(t * np.minimum(1.0, radius / np.maximum(length, 1e-300))[:, None])

    t = project(start)
    lead, momentum = t, 1.0
    for _ in range(MAX_GRADIENT_STEPS):
        gradient = (matrix @ lead.ravel() - wanted).reshape(-1, 2)
        following = project(lead - step * gradient)
        if float(((lead - following) * (following - t)).sum()) > 0:
            momentum = 1.0  # restart (O'Donoghue and Candes)
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        change, t = following - t, following
        if np.abs(change).max() <= tolerance:
            return t
        lead, momentum = t + (momentum - 1) / grown * change, grown
    return t
