"""Rigid indenters on the pad: unilateral contact with Coulomb friction along a loading path.

Contact acts at the surface nodes, so the nodal forces are exact. Force ON the pad, z out of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.pad import PadModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Indenter:
    """A ball ("sphere") or a flat-ended round punch ("flat")."""

    shape: str
    radius_m: float

    def __post_init__(self) -> None:
        if self.shape not in ("sphere", "flat"):
            raise InputError(f"unknown indenter {self.shape!r}: sphere or flat")
        if not self.radius_m > 0:
            raise InputError(f"the indenter's radius must be positive, got {self.radius_m}")

    def height(self, r: Array) -> Array:
        """Height of its surface above its lowest point at distance r from the axis (inf outside)."""
        inside = r < self.radius_m
        if self.shape == "flat":
            return np.where(inside, 0.0, np.inf)
        cap = self.radius_m - np.sqrt(np.maximum(self.radius_m**2 - r**2, 0.0))
        return np.where(inside, cap, np.inf)


@dataclass(frozen=True)
class Pose:
    """Where the indenter is: axis (x, y), depth of its lowest point below the surface, turn about z."""

    x_m: float
    y_m: float
    depth_m: float
    turn_rad: float = 0.0


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
    _force: Array = field(init=False)
    _displacement: Array = field(init=False)
    _pose: Pose | None = None

    def __post_init__(self) -> None:
        x, y = np.meshgrid(self.model.node_x(), self.model.node_y())
        self._x, self._y = x.ravel(), y.ravel()
        self._force = np.zeros((self._x.size, 3))
        self._displacement = np.zeros((self._x.size, 3))

    @property
    def force(self) -> Array:
        """Nodal force, (n, 3), newtons."""
        return self._force

    @property
    def displacement(self) -> Array:
        """Nodal displacement of the surface, (n, 3), metres."""
        return self._displacement

    def advance(self, pose: Pose) -> None:
        """Move the indenter; stick and slip follow from where it was before.

        Raises
        ------
        InputError
            The indenter's axis leaves the pad, or presses through it.
        """
        half = (self.model.size_x_m / 2, self.model.size_y_m / 2)
        if abs(pose.x_m) > half[0] or abs(pose.y_m) > half[1]:
            raise InputError(f"the indenter at ({pose.x_m:.4f}, {pose.y_m:.4f}) m is beside the pad")
        if pose.depth_m > 0.5 * self.model.thickness_m:
            raise InputError(f"depth {pose.depth_m:.4f} m is more than half the pad: no linear model holds there")
        # The surface yields to the axis' place on the undeformed pad: shear moves the pad with the tool.
        reach = np.hypot(self._x - pose.x_m, self._y - pose.y_m)
        gap = self.indenter.height(reach) - pose.depth_m
        near = np.flatnonzero(gap < 0)
        if not near.size:
            self._force[:], self._displacement[:] = 0.0, 0.0
            self._pose = pose
            return
        unknowns = (3 * near[:, None] + np.arange(3)).ravel()
        sub = self.compliance[np.ix_(unknowns, unknowns)]
        target = self._stick_target(near, pose)
        force = self._solve(sub, gap[near], target, self._force[near])
        self._force[:] = 0.0
        self._force[near] = force
        self._displacement = (self.compliance[:, unknowns] @ force.ravel()).reshape(-1, 3)
        self._pose = pose

    def _stick_target(self, near: npt.NDArray[np.intp], pose: Pose) -> Array:
        """Tangential displacement that each node would have if it stuck since the last pose, (m, 2)."""
        before = self._pose
        moved = self._displacement[near, :2].copy()
        if before is None or before.depth_m <= 0:
            return moved
        turn = pose.turn_rad - before.turn_rad
        arm = np.stack([self._x[near] - before.x_m, self._y[near] - before.y_m], axis=1)
        step = np.array([pose.x_m - before.x_m, pose.y_m - before.y_m])
        return moved + step + turn * np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    def _solve(self, sub: Array, gap: Array, target: Array, start: Array) -> Array:
        """Alternate the normal complementarity problem and the friction problem until they agree."""
        m = len(gap)
        c = sub.reshape(m, 3, m, 3)
        normal = c[:, 2, :, 2]
        tangent = c[:, :2, :, :2].reshape(2 * m, 2 * m)
        cross = c[:, 2, :, :2].reshape(m, 2 * m)  # u_z from tangential force
        pressure = np.maximum(-start[:, 2], 0.0)
        shear = start[:, :2].copy()
        largest = _largest_eigenvalue(tangent)
        for _ in range(12):
            previous = pressure.copy(), shear.copy()
            # u_z = normal (-p) + cross t <= gap where touching: normal p = cross t - gap on the active set.
            pressure = _nonnegative(normal, cross @ shear.ravel() - gap, pressure > 0)
            wanted = target.ravel() + cross.T @ pressure
            shear = _in_discs(tangent, wanted, self.friction * pressure, shear, 1 / largest)
            change = np.abs(pressure - previous[0]).max() + np.abs(shear - previous[1]).max()
            if change < 1e-5 * max(pressure.max(), 1e-9):
                break
        return np.column_stack([shear, -pressure])


def _largest_eigenvalue(matrix: Array) -> float:
    v = np.ones(len(matrix))
    for _ in range(30):
        v = matrix @ v
        v /= np.linalg.norm(v)
    return float(v @ matrix @ v) * 1.02


def _nonnegative(matrix: Array, right: Array, active: npt.NDArray[np.bool_]) -> Array:
    """p >= 0, matrix p - right >= 0, complementary: primal-dual active set (matrix SPD)."""
    active = active | (right > 0) if not active.any() else active
    scale = float(np.abs(right).max())
    for _ in range(60):
        p = np.zeros(len(right))
        if active.any():
            p[active] = np.linalg.solve(matrix[np.ix_(active, active)], right[active])
        lack = right - matrix @ p  # > 0: would penetrate
        wanted = (active & (p > 0)) | (~active & (lack > 1e-9 * scale))
        if (wanted == active).all():
            return p
        active = wanted
    return np.maximum(p, 0.0)


def _in_discs(matrix: Array, wanted: Array, radius: Array, start: Array, step: float) -> Array:
    """Minimise t.A t / 2 - wanted.t with |t_i| <= radius_i: accelerated projected gradient."""

    def project(t: Array) -> Array:
        length = np.hypot(t[:, 0], t[:, 1])
        return np.asarray(t * np.minimum(1.0, radius / np.maximum(length, 1e-15))[:, None])

    t = project(start)
    lead, momentum = t, 1.0
    tolerance = 1e-6 * max(float(radius.max(initial=0.0)), 1e-12)
    for _ in range(400):
        gradient = (matrix @ lead.ravel() - wanted).reshape(-1, 2)
        following = project(lead - step * gradient)
        if float(((lead - following) * (following - t)).sum()) > 0:
            momentum = 1.0  # restart
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        lead = following + (momentum - 1) / grown * (following - t)
        if np.abs(following - t).max() < tolerance:
            return following
        t, momentum = following, grown
    return t


def wrench_of(model: PadModel, force: Array) -> Array:
    """Force (N) and moment (N m) about the undeformed pad centre of nodal forces (n, 3): (6,)."""
    x, y = np.meshgrid(model.node_x(), model.node_y())
    arm = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return np.concatenate([force.sum(axis=0), np.cross(arm, force).sum(axis=0)])


def transfer_forces(model: PadModel, force: Array, n_x: int, n_y: int) -> Array:
    """Nodal forces shared out to another grid over the same pad, (n_y, n_x, 3).

    Bilinear shares keep force and moments.
    """

    def shares(n_from: int, n_to: int) -> Array:
        place = np.linspace(0, n_to - 1, n_from)
        low = np.minimum(place.astype(int), n_to - 2)
        out = np.zeros((n_to, n_from))
        out[low, np.arange(n_from)] = 1 - (place - low)
        out[low + 1, np.arange(n_from)] += place - low
        return out

    rows, columns = model.shape
    field_ = force.reshape(rows, columns, 3)
    return np.einsum("ai,bj,ijc->abc", shares(rows, n_y), shares(columns, n_x), field_)
