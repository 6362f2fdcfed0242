"""A rubber dome under a rigid tool: shell at large displacement, contact with Coulomb friction, relaxation.

The middle surface is a half sphere with its top at the origin on a cylinder (`optics.charts.Dome`, its coordinates),
clamped where the half sphere ends. The wall gives way locally like a layer of rubber: pressure = E / t times the
overlap with the tool, sticking shear = E / (3 t) times the way since it stuck, at most friction times pressure.
Balance by Newton's method in steps of the tool's way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.bodies.splines import Line, Patch
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.pad import BLAS
from ruffini.sim.prony import Memory, Prony

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

FINE = 0.55  # of the even spacing: lines about the top
MAX_STEP_M = 0.25e-3  # of the tool between two equilibria
MAX_ROUNDS = 60
UNDAMPED_ROUNDS = 10  # then points at an edge of the tool may swing about it
N_TOUCH = 6  # samples of contact along each side of an element
TOLERANCE = 1e-6  # of unbalanced force, of the tool's force
MAX_MOVE_M = 1e-3  # of a control point in one round
LEAST_FORCE_N = 1e-3
HALVINGS = 4  # of a step that finds no balance


def places(a: Array, b: Array, radius: float) -> Array:
    """Points (..., 3) at ways (a, b) from the top along the surface; all lengths in one unit."""
    way = np.hypot(a, b)
    angle = np.minimum(way / radius, np.pi / 2)
    part = np.where(way > 1e-9 * radius, radius * np.sin(angle) / np.maximum(way, 1e-12 * radius), 1.0)
    return np.stack([a * part, b * part, radius * (np.cos(angle) - 1) - np.maximum(way - radius * np.pi / 2, 0)], -1)


def _graded(half: float, n: int) -> Array:
    t = np.linspace(-1, 1, n + 1)
    return half * t * (FINE + (1 - FINE) * t**2)


@dataclass
class DomeModel:
    """A dome's shell and what of it can move; metres."""

    radius_m: float
    thickness_m: float
    modulus_pa: float
    poisson: float
    n_cells: int
    shell: Shell = field(init=False)

    def __post_init__(self) -> None:
        half = np.pi / 2 * self.radius_m
        line = Line(_graded(half, self.n_cells))
        patch = Patch.of(line, line)
        home_a, home_b = np.meshgrid(line.greville(), line.greville())
        rest = patch.interpolated(places(home_a, home_b, self.radius_m))
        self.shell = Shell(patch, rest, self.thickness_m, self.modulus_pa, self.poisson)
        self.is_free: Bools = np.hypot(home_a, home_b).ravel() < half
        self.sampled, weights = patch.samples(N_TOUCH)
        along = [values @ rest[patch.functions] for values in self.sampled[1:]]
        self.touch_areas = np.linalg.norm(np.cross(*along), axis=-1) * weights  # (elements, samples) square metres
        self.points = patch.spread(self.sampled[0])
        self._gather()

    def _gather(self) -> None:
        """Where each element's tangent goes in the matrix of the free unknowns."""
        functions = self.shell.patch.functions
        number = np.where(self.is_free, np.cumsum(self.is_free) - 1, -1)
        dofs = 3 * number[functions][:, :, None] + np.where(number[functions][:, :, None] < 0, -9, np.arange(3))
        dofs = dofs.reshape(len(functions), 48)
        rows, columns = np.repeat(dofs, 48, axis=1), np.tile(dofs, (1, 48))
        self._kept = ((rows >= 0) & (columns >= 0)).ravel()
        n = 3 * int(self.is_free.sum())
        flat = columns.ravel()[self._kept].astype(np.int64) * n + rows.ravel()[self._kept]
        unique, self._slot = np.unique(flat, return_inverse=True)
        self._pattern = (unique % n, np.concatenate([[0], np.cumsum(np.bincount(unique // n, minlength=n))]))
        self.n_free = n

    def matrix(self, elements: Array) -> sp.csc_matrix:
        """Tangents of the elements (m, 48, 48) as one matrix of the free unknowns."""
        data = np.bincount(self._slot, elements.reshape(-1)[self._kept], minlength=len(self._pattern[0]))
        return sp.csc_matrix((data, *self._pattern), shape=(self.n_free, self.n_free))


class DomeState:
    """A dome in time, under one tool after the other. Forces act ON the dome."""

    def __init__(self, model: DomeModel, friction: float, relaxation: Prony) -> None:
        self.model, self.friction = model, friction
        self.place = model.shell.rest.copy()
        self._memory = Memory(relaxation)
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
            return
        self._check(tool)

    def _above(self, tool: ToolContact, end: Grip) -> Grip:
        """Where a tool comes from that is first seen at `end`: out along its axis, just clear of the surface."""
        return end.lifted(tool.deepest(end, self.contact_places))

    def _check(self, tool: ToolContact) -> None:
        floor = -self.model.radius_m
        if tool.grip is not None and tool.grip.tip[2] < floor:
            raise InputError(
                f"the tool's tip is {-tool.grip.tip[2] * 1e3:.1f} mm below the top, below the rim: press less deep"
            )

    def _balance(self, tool: ToolContact | None, duration_s: float) -> None:
        model, shell, memory = self.model, self.model.shell, self._memory
        memory.begin(duration_s)
        place, free = self.place.copy(), model.is_free
        with BLAS.limit(limits=1):
            for i in range(MAX_ROUNDS):
                force, tangent = shell.balance(place, memory.factor, memory.held)
                total = LEAST_FORCE_N
                if tool is not None:
                    pushed, pushed_tangent = tool.press(np.asarray(model.points @ place), self.friction)
                    load = model.touch_areas.reshape(-1, 1) * pushed
                    force -= model.points.T @ load
                    tangent += _spread(model, pushed_tangent)
                    total += float(np.linalg.norm(load.sum(axis=0)))
                lack = force[free]
                if np.abs(lack).max() < TOLERANCE * total:
                    break
                move = -splu(model.matrix(tangent)).solve(lack.ravel()).reshape(-1, 3)
                largest = float(np.abs(move).max())
                if not np.isfinite(largest):
                    raise RuffiniError("the simulated dome lost its stiffness: press less deep")
                place[free] += move * min(1.0 if i < UNDAMPED_ROUNDS else 0.5, MAX_MOVE_M / largest)
            else:
                raise RuffiniError(f"the simulated dome found no balance in {MAX_ROUNDS} rounds: press less deep")
        self.place = place
        memory.commit(shell.resultants(place))
        if tool is None:
            self.force, self.slips = np.zeros_like(self.force), np.zeros_like(self.slips)
        else:
            self.force, self.slips = load, tool.commit()


def _spread(model: DomeModel, tangent: Array) -> Array:
    """Tangents at the samples of contact (n, 3, 3), per area, as the elements' tangents, (elements, 48, 48)."""
    n0, areas = model.sampled[0], model.touch_areas
    weighted = tangent.reshape(*areas.shape, 3, 3) * areas[..., None, None]
    out = np.zeros((len(n0), 16, 3, 16, 3))
    used = np.flatnonzero(weighted.any(axis=(1, 2, 3)))
    out[used] = np.einsum("eqa,eqij,eqb->eaibj", n0[used], weighted[used], n0[used], optimize=True)
    return out.reshape(len(n0), 48, 48)
