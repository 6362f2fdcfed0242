"""A thin shell that a tool presses: its free unknowns, and balance by Newton's method in steps of the tool's way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.linalg.lapack import dgbtrf, dgbtrs

from ruffini.errors import RuffiniError
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.pad import BLAS
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

N_TOUCH = 6  # samples of contact along each side of an element
MAX_STEP_M = 0.25e-3  # of the tool between two equilibria
MAX_ROUNDS = 60
UNDAMPED_ROUNDS = 10  # then points at an edge of the tool may swing about it
TOLERANCE = 1e-6  # of unbalanced force, of the tool's force
MAX_MOVE_M = 1e-3  # of a control point in one round
LEAST_FORCE_N = 1e-3
NEAR = 0.03  # of unbalanced force, of the tool's force: so near, the last step's tangent will do
CONTRACTION = 0.1  # of the unbalanced force in a round: else the tangent is rebuilt and refactorised
HALVINGS = 4  # of a step that finds no balance


@dataclass
class Sheet:
    """A shell and which components (n, 3) of its control points can move."""

    shell: Shell
    is_free: Bools
    points: sp.csr_matrix = field(init=False)  # from control points to the samples of contact

    def __post_init__(self) -> None:
        patch = self.shell.patch
        self.sampled, weights = patch.samples(N_TOUCH)
        along = [values @ self.shell.rest[patch.functions] for values in self.sampled[1:]]
        long = np.cross(*along)
        length = np.linalg.norm(long, axis=-1)
        self.touch_areas = length * weights  # (elements, samples) square metres
        self.normals = long / length[..., None]  # at rest, (elements, samples, 3)
        self.points = patch.spread(self.sampled[0])
        self._gather()

    def _gather(self) -> None:
        """Where each element's tangent goes in the band of the free unknowns' matrix, as LAPACK's gbtrf wants it."""
        functions, free = self.shell.patch.functions, self.is_free.ravel()
        number = np.where(free, np.cumsum(free) - 1, -1)
        dofs = number[(3 * functions[:, :, None] + np.arange(3)).reshape(len(functions), 48)]
        rows, columns = np.repeat(dofs, 48, axis=1).ravel(), np.tile(dofs, (1, 48)).ravel()
        self._kept = (rows >= 0) & (columns >= 0)
        rows, columns = rows[self._kept], columns[self._kept]
        self._half = int(np.abs(rows - columns).max())
        self.n_free = int(free.sum())
        self._slot = columns * (3 * self._half + 1) + 2 * self._half + rows - columns

    def solver(self, elements: Array) -> Callable[[Array], Array]:
        """From forces to moves of the free unknowns, (n_free, ...), by the elements' tangents, (m, 48, 48).

        Raises
        ------
        RuffiniError
            The tangent is singular.
        """
        half, height = self._half, 3 * self._half + 1
        band = np.bincount(self._slot, elements.reshape(-1)[self._kept], minlength=height * self.n_free)
        factors, pivots, info = dgbtrf(band.reshape(self.n_free, height).T, half, half, overwrite_ab=1)
        if info:
            raise RuffiniError("the simulated shell lost its stiffness: press less deep")

        def solve(forces: Array) -> Array:
            return np.asarray(dgbtrs(factors, half, half, forces, pivots)[0])

        return solve

    def rest_points(self) -> Array:
        """Samples of contact at rest, (n, 3)."""
        return np.asarray(self.points @ self.shell.rest)

    def spread(self, tangent: Array) -> Array:
        """Tangents at the samples (n, 3, 3), per area, as the elements' tangents, (elements, 48, 48)."""
        n0, areas = self.sampled[0], self.touch_areas
        weighted = tangent.reshape(*areas.shape, 3, 3) * areas[..., None, None]
        out = np.zeros((len(n0), 16, 3, 16, 3))
        used = np.flatnonzero(weighted.any(axis=(1, 2, 3)))
        out[used] = np.einsum("eqa,eqij,eqb->eaibj", n0[used], weighted[used], n0[used], optimize=True)
        return out.reshape(len(n0), 48, 48)


class Foundation(Protocol):
    """What the sheet lies on."""

    def begin(self, duration_s: float) -> None:
        """A step of this duration."""

    def hold(self, moved: Array) -> tuple[Array, Callable[[], Array]]:
        """Forces (n, 3) on the samples that moved by (n, 3), newtons, and what makes the elements' tangents, (elements,
        48, 48).
        """

    def commit(self) -> None:
        """The last `hold` ends the step."""


class SheetState:
    """A sheet in time, under one tool after the other. Forces are the tool's, ON the sheet."""

    def __init__(
        self, model: Sheet, friction: float, relaxation: Prony | None = None, foundation: Foundation | None = None
    ) -> None:
        self.model, self.friction = model, friction
        self.place = model.shell.rest.copy()
        self._memory, self._foundation = Memory(relaxation or Prony()), foundation
        self._rest_points = model.rest_points()
        self._solve: Callable[[Array], Array] | None = None  # with the newest tangent that was factorised
        n = model.points.shape[0]
        self.force: Array = np.zeros((n, 3))  # N, at the samples of contact
        self.slips: Bools = np.zeros(n, dtype=bool)

    @property
    def contact_places(self) -> Array:
        """Where the samples of contact are now, (n, 3)."""
        return np.asarray(self.model.points @ self.place)

    def wrench(self) -> Array:
        """Force and moment about the origin, at the places where the forces act now, (6,)."""
        return np.concatenate([self.force.sum(axis=0), np.cross(self.contact_places, self.force).sum(axis=0)])

    def free(self, duration_s: float) -> None:
        """A time in which nothing touches."""
        self._balance(None, duration_s)

    def advance(self, tool: ToolContact, end: Grip, duration_s: float) -> None:
        """Move the tool in a straight line.

        Raises
        ------
        RuffiniError
            No balance was found.
        """
        start = tool.grip or self._above(tool, end)
        n_steps = max(1, int(np.ceil(start.way_to(end) / MAX_STEP_M - 1e-6)))
        for i in range(n_steps):
            self._step(tool, start.towards(end, (i + 1) / n_steps), duration_s / n_steps, HALVINGS)

    def _step(self, tool: ToolContact, end: Grip, duration_s: float, halvings: int) -> None:
        before, start = self.place.copy(), tool.grip or self._above(tool, end)
        tool.move(end)
        try:
            self._balance(tool, duration_s)
        except RuffiniError:
            if not halvings:
                raise
            self.place = before
            tool.move(start)
            self._step(tool, start.towards(end, 0.5), duration_s / 2, halvings - 1)
            self._step(tool, end, duration_s / 2, halvings - 1)

    def _above(self, tool: ToolContact, end: Grip) -> Grip:
        """Where a tool comes from that is first seen at `end`: out along its axis, just clear of the surface."""
        return end.lifted(max(tool.deepest(end, self.contact_places), 0.0))

    def _balance(self, tool: ToolContact | None, duration_s: float) -> None:
        model, shell, memory = self.model, self.model.shell, self._memory
        memory.begin(duration_s)
        if self._foundation is not None:
            self._foundation.begin(duration_s)
        if tool is not None:
            tool.begin(duration_s)
        place, free, load = self.place.copy(), model.is_free, np.zeros_like(self.force)
        before = 0.0  # unbalanced force of the round before
        with BLAS.limit(limits=1):
            for i in range(MAX_ROUNDS):
                force, tangent_of = shell.balance(place, memory.factor, memory.held)
                points, total = np.asarray(model.points @ place), LEAST_FORCE_N
                if self._foundation is not None:
                    held, held_tangent_of = self._foundation.hold(points - self._rest_points)
                    force -= model.points.T @ held
                if tool is not None:
                    pushed, pushed_tangent = tool.press(points, self.friction)
                    load = model.touch_areas.reshape(-1, 1) * pushed
                    force -= model.points.T @ load
                    total += float(np.linalg.norm(load.sum(axis=0)))
                lack = force[free]
                largest_lack = float(np.abs(lack).max())
                if largest_lack < TOLERANCE * total:
                    break
                is_near = largest_lack < CONTRACTION * before if i else tool is None or largest_lack < NEAR * total
                if self._solve is None or not is_near:
                    tangent = tangent_of()
                    if self._foundation is not None:
                        tangent += held_tangent_of()
                    if tool is not None:
                        tangent += model.spread(pushed_tangent)
                    self._solve = model.solver(tangent)
                before = largest_lack
                move = -self._solve(lack)
                largest = float(np.abs(move).max())
                if not np.isfinite(largest):
                    raise RuffiniError("the simulated shell lost its stiffness: press less deep")
                place[free] += move * min(1.0 if i < UNDAMPED_ROUNDS else 0.5, MAX_MOVE_M / largest)
            else:
                raise RuffiniError(f"the simulated shell found no balance in {MAX_ROUNDS} rounds: press less deep")
        self.place, self.force = place, load
        memory.commit(shell.resultants(place))
        if self._foundation is not None:
            self._foundation.commit()
        self.slips = tool.commit() if tool is not None else np.zeros_like(self.slips)
