"""A board's pad, reduced: the twin's own compliance between tractions on a coarse grid, with contact and friction.

`PadSolid` is the linear pad of `ruffini.sim.pad` on as few nodes as its thickness allows, and is shared.

`PadContact` is what presses on one pad, step by step: pressure p >= 0 with G_zz p = depth where it presses (an active
set that starts from the last step's), and shear with |t| <= mu p by a slider at each node, G_xx t_x = s_x where it
sticks. What shear adds to depth, and x to y, is left out of the contact; the displacement is the full compliance times
all forces. G is symmetric and positive, so a pad at rest gives back no more energy than was put in.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from ruffini.boards import Board
from ruffini.errors import InputError, RuffiniError
from ruffini.sim.complementarity import nonnegative
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.surface import hat_shares
from ruffini.sim.unit import PadError, TwinUnit

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NODES_PER_THICKNESS = 4  # a pressure that varies faster hardly moves the pad
KEPT_SETS = 256  # active sets that come again
MAX_ROUNDS = 30  # of the active set; if it cycles, a solver that always ends takes over
SLIDER_ROUNDS = 6  # of what sticks taking over from what slips; the rest follows in the next steps
OPEN_M = 1e-9  # gap that is rounding
NOT_DEFINITE = "the robot's pad has a compliance that is not positive definite: its mesh is too fine"


@dataclass(frozen=True)
class PadSolid:
    """A linear pad on a coarse grid: what forces at its nodes do to them and to the board's nodes.

    Attributes
    ----------
    unit : the twin of that coarse mesh, whose renderer shows it.
    place : (n, 2) nodes, metres from the pad's centre.
    """

    unit: TwinUnit
    place: Array

    @classmethod
    def of_board(cls, board: Board, *, stiffness: float = 1.0) -> PadSolid:
        """The pad of a board's twin, `stiffness` times as stiff.

        Raises
        ------
        InputError
            The board has no flat twin pad at small strain.
        """
        twin = load_twin(board)
        if twin.shape.kind != "plane" or twin.platform is not None or board.markers is None:
            body = "pad on a platform" if twin.platform is not None else twin.shape.kind
            raise InputError(f"board {board.name!r} is a {body}: the reduced model has flat pads that are pressed")
        pad = board.pad
        cells = [
            max(2, round(NODES_PER_THICKNESS * size / pad.thickness_um / 2)) for size in (pad.size_x_um, pad.size_y_um)
        ]
        mesh = MeshSettings(cells_x=cells[0], cells_y=cells[1])
        linear = twin.with_pad(strain="linear", is_relaxing=False).model_copy(update={"mesh": mesh})
        unit = TwinUnit.build(board, PadError(modulus=stiffness), twin=linear)
        x, y = np.meshgrid(unit.model.node_x(), unit.model.node_y())
        return cls(unit, np.column_stack([x.ravel(), y.ravel()]))

    @cached_property
    def surface(self) -> Array:
        """Displacement of the nodes for unit hat forces, (3 n, n, 3)."""
        n, shares = len(self.place), hat_shares(self.unit.model)
        compliance = self.unit.compliance.reshape(3 * n, n, 3)
        return np.stack([np.asarray(compliance[:, :, c] @ shares) for c in range(3)], axis=2)

    @cached_property
    def mean(self) -> Array:
        """Compliances of x to x, y to y, z to z, (3, n, n): displacement that a node's hat weighs; symmetric."""
        n, shares = len(self.place), hat_shares(self.unit.model)
        own = self.surface.reshape(n, 3, n, 3)
        return np.stack([np.asarray(shares.T @ own[:, c, :, c]) for c in range(3)])

    @cached_property
    def to_board(self) -> npt.NDArray[np.float32]:
        """Displacement of the board's observed nodes for unit hat forces, (3 n, 3 m)."""
        n = len(self.place)
        surface = self.surface.reshape(n, 3, 3 * n)
        columns = [self.unit.at_nodes(surface[:, :, k])[self.unit.board.observed].ravel() for k in range(3 * n)]
        return np.asarray(columns, np.float32)

    @cached_property
    def stiffness_n_per_m(self) -> float:
        """Force per depth of a flat that presses the whole pad: no contact is stiffer."""
        return float(np.linalg.solve(self.mean[2], np.ones(len(self.place))).sum())

    @property
    def half_size_m(self) -> tuple[float, float]:
        return self.unit.model.size_x_m / 2, self.unit.model.size_y_m / 2


class _NodeSet:
    """Nodes of a pad by themselves: compliances x to x, y to y, z to z, and their Cholesky factors, once needed."""

    def __init__(self, mean: Array, nodes: Indices) -> None:
        self._mean, self._nodes = mean, nodes
        self._own: dict[int, Array] = {}
        self._factors: dict[int, Array] = {}

    def own(self, axis: int) -> Array:
        """Compliance along an axis, (m, m)."""
        if axis not in self._own:
            self._own[axis] = _among(self._mean[axis], self._nodes)
        return self._own[axis]

    def solve(self, axis: int, moved: Array) -> Array:
        """Forces (m,) along an axis that move the nodes so far."""
        if not moved.size:
            return np.zeros(0)
        if axis not in self._factors:
            factor, failed = dpotrf(self.own(axis).T)
            if failed:
                raise RuffiniError(NOT_DEFINITE)
            self._factors[axis] = factor
        return np.asarray(dpotrs(self._factors[axis], moved)[0])

    def sheared(self, t: Array) -> Array:
        """Displacement along x and y of shear (m, 2)."""
        out = np.empty_like(t)
        for c in range(2):
            out[:, c] = self.own(c) @ t[:, c]
        return out

    def shear(self, moved: Array) -> Array:
        """Shear (m, 2) that moves the nodes so far along x and y."""
        out = np.empty_like(moved)
        for c in range(2):
            out[:, c] = self.solve(c, moved[:, c])
        return out

    @cached_property
    def step(self) -> float:
        """Of a gradient's descent in shear that does not overshoot."""
        return 1 / max(float(self.own(c).sum(axis=1).max()) for c in range(2))


def _among(matrix: Array, nodes: Indices) -> Array:
    """Rows and columns of these nodes."""
    return matrix.take(nodes[:, None] * len(matrix) + nodes)


@dataclass
class PadContact:
    """What presses on a pad, step after step.

    Attributes
    ----------
    force : (n, 3) N ON the pad's nodes.
    slips : (n,) nodes whose shear is at its limit.
    """

    solid: PadSolid
    force: Array = field(init=False)
    slips: npt.NDArray[np.bool_] = field(init=False)
    _was_touched: npt.NDArray[np.bool_] = field(init=False)
    _stretch: Array = field(init=False)  # (n, 2) m that each node's slider has stretched the pad
    _kept: OrderedDict[bytes, _NodeSet] = field(init=False, default_factory=OrderedDict)

    def __post_init__(self) -> None:
        self._mean = self.solid.mean
        n = len(self.solid.place)
        self.force, self._stretch, self.slips = np.zeros((n, 3)), np.zeros((n, 2)), np.zeros(n, bool)
        self._was_touched = np.zeros(n, bool)

    def release(self) -> None:
        """Nothing touches."""
        self.force[:], self._stretch[:], self.slips[:], self._was_touched[:] = 0.0, 0.0, False, False

    def advance(self, depth: Array, motion: Array, friction: Array, lead: Array) -> None:
        """One step.

        Parameters
        ----------
        depth : (n,) m by which the object is below the undeformed face at each node; not positive: beside it.
        motion : (n, 2) m that its surface has moved along the pad since the last step.
        friction : (n,) Coulomb coefficient.
        lead : (n, 3) m, the relaxation time of the pad's damping times the velocity of x, y and depth.
        """
        nodes = self._press(depth, lead[:, 2])
        if nodes.size:
            self._shear(nodes, motion, friction, lead[:, :2])
        else:
            self.release()

    def _node_set(self, nodes: Indices) -> _NodeSet:
        key = nodes.tobytes()
        if key not in self._kept:
            self._kept[key] = _NodeSet(self._mean, nodes)
            if len(self._kept) > KEPT_SETS:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _press(self, depth: Array, lead: Array) -> Indices:
        """Pressure; the nodes that press."""
        touched = np.flatnonzero(depth > 0)
        depth = depth[touched] + lead[touched]
        active = (self.force[touched, 2] < 0) | ~self._was_touched[touched]
        self._was_touched[:] = False
        self._was_touched[touched] = True
        pressure = np.zeros(0)
        for _ in range(MAX_ROUNDS):
            nodes = touched[active]
            pressure = self._node_set(nodes).solve(2, depth[active])
            if nodes.size and pressure.min() < 0:
                active[np.flatnonzero(active)[pressure < 0]] = False
                continue
            if active.all():
                break
            beside = np.flatnonzero(~active)
            lack = depth[beside] - self._mean[2][touched[beside][:, None], nodes] @ pressure
            if not (lack > OPEN_M).any():
                break
            active[beside[lack > OPEN_M]] = True
        else:
            pressure = nonnegative(self._mean[2][touched[:, None], touched], depth, active)
            nodes, pressure = touched[pressure > 0], pressure[pressure > 0]
        self.force[:, 2] = 0.0
        self.force[nodes, 2] = -np.maximum(pressure, 0)
        return np.asarray(nodes)

    def _shear(self, nodes: Indices, motion: Array, friction: Array, lead: Array) -> None:
        """Friction: sliders at the nodes that press."""
        was = (self.force[:, 0] != 0) | (self.force[:, 1] != 0)
        carried = np.flatnonzero(was)
        begun = nodes[~was[nodes]]  # touched where the pad has been drawn to by its neighbours
        if begun.size and carried.size:
            for c in range(2):
                self._stretch[begun, c] = self._mean[c][begun[:, None], carried] @ self.force[carried, c]
        stretch = self._stretch[nodes] + motion[nodes]
        asked = stretch + lead[nodes]
        limit = friction[nodes] * -self.force[nodes, 2]
        own = self._node_set(nodes)
        t = own.shear(asked)
        slips = np.hypot(t[:, 0], t[:, 1]) > limit
        if slips.any():
            t, slips = _sliding(own, asked, limit, self.force[nodes, :2], slips & self.slips[nodes])
            stretch[slips] = (own.sheared(t) - lead[nodes])[slips]
        self.force[:, :2], self._stretch[:], self.slips[:] = 0.0, 0.0, False
        self.force[nodes, :2], self._stretch[nodes], self.slips[nodes] = t, stretch, slips

    def _loaded(self) -> Indices:
        return np.flatnonzero(self.force.any(axis=1))

    def board_displacement(self) -> Array:
        """Displacement of the board's observed nodes, (m, 3) metres."""
        nodes = self._loaded()
        rows = self.solid.to_board.reshape(len(self.force), 3, -1)[nodes]
        forces = self.force[nodes].astype(np.float32)
        return np.asarray(np.einsum("ic,icm->m", forces, rows, optimize=True), np.float64).reshape(-1, 3)

    def surface_displacement(self) -> Array:
        """Displacement of the twin's own nodes, (n, 3) metres, which its renderer shows."""
        nodes = self._loaded()
        moved = np.einsum("kic,ic->k", self.solid.surface[:, nodes], self.force[nodes], optimize=True)
        return np.asarray(moved).reshape(-1, 3)


def wrench_about(place: Array, force: Array) -> Array:
    """Force and moment about the origin of forces (n, 3) at points (x, y, 0) = `place` (n, 2), (6,)."""
    total, turn = force.sum(axis=0), place.T @ force
    return np.array([*total, turn[1, 2], -turn[0, 2], turn[0, 1] - turn[1, 0]])


def _sliding(
    own: _NodeSet, asked: Array, limit: Array, last: Array, slips: npt.NDArray[np.bool_]
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Shear (n, 2) that gives what sticks the `asked` displacement, and is `limit` at what slips; and what slips.

    An active set, from `slips` on: what slips pulls the way that it lacks, and sticks again where that turns round.
    """

    def at_limit(t: Array) -> Array:
        return t * (limit / np.maximum(np.hypot(t[:, 0], t[:, 1]), 1e-300))[:, None]

    t = last
    for _ in range(SLIDER_ROUNDS):
        pull = t + own.step * (asked - own.sheared(t))
        t = np.where(slips[:, None], at_limit(pull), 0.0)
        sticks = np.flatnonzero(~slips)
        lack = asked - own.sheared(t)
        if sticks.size:
            for c in range(2):
                _, found, failed = dposv(_among(own.own(c), sticks).T, lack[sticks, c], overwrite_a=1)
                if failed:
                    raise RuffiniError(NOT_DEFINITE)
                t[sticks, c] = found
            lack = asked - own.sheared(t)
        over = ~slips & (np.hypot(t[:, 0], t[:, 1]) > limit)
        back = slips & ((lack * t).sum(axis=1) < 0)
        if not (over | back).any():
            break
        slips = (slips | over) & ~back
    over = np.hypot(t[:, 0], t[:, 1]) > limit
    return np.where(over[:, None], at_limit(t), t), slips | over
