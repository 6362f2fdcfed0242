"""A story of touches, played frame by frame on one unit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.contact import ContactSolver, Pose
from ruffini.sim.programs import Rest, Step
from ruffini.sim.surface import wrench_of
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """The truth of one frame; `solver` and `pose` are None where nothing touches.

    displacement : (n, 3) metres at the surface nodes of the mechanics.
    """

    unit: TwinUnit
    displacement: Array
    touch: int = -1
    pose: Pose | None = None
    judged: bool = False
    solver: ContactSolver | None = None

    def wrench(self) -> Array:
        """Force (N) and moment (N m) about the pad's centre, (6,)."""
        return wrench_of(self.unit.model, self.solver.nodal_force) if self.solver else np.zeros(6)

    def pose_row(self) -> Array:
        """x, y, depth (m), turn, roll and pitch (rad), NaN where nothing touches, (6,)."""
        return self.pose.row() if self.pose else np.full(6, np.nan)

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        """0 free, 1 sticks, 2 slips: the nearest node of the mechanics to each of the board's, (n_y, n_x)."""
        grid, (n_y, n_x) = self.unit.board.grid, self.unit.model.shape
        if self.solver is None:
            return np.zeros((grid.n_y, grid.n_x), np.uint8)
        rows, columns = (np.rint(np.linspace(0, n - 1, m)).astype(int) for n, m in ((n_y, grid.n_y), (n_x, grid.n_x)))
        return np.asarray(self.solver.contact_state.reshape(n_y, n_x)[np.ix_(rows, columns)])

    def nodal_force(self) -> Array:
        """Force (N) at the board's nodes, (n_y, n_x, 3)."""
        grid = self.unit.board.grid
        return self.solver.forces_on_grid(grid.n_x, grid.n_y) if self.solver else np.zeros((grid.n_y, grid.n_x, 3))

    def nodal_displacement(self) -> Array:
        """Displacement (m) at the board's nodes, (n_y, n_x, 3)."""
        grid = self.unit.board.grid
        return self.unit.at_nodes(self.displacement) if self.solver else np.zeros((grid.n_y, grid.n_x, 3))


def play(unit: TwinUnit, story: Iterable[Step]) -> Iterator[Moment]:
    """One moment a frame. A moment's solver goes on with the next one: take what is needed first.

    Raises
    ------
    InputError
        An indenter leaves the pad.
    """
    at_rest, touch = unit.at_rest(), -1
    for step in story:
        if isinstance(step, Rest):
            for _ in range(step.n_frames):
                yield Moment(unit, at_rest)
            continue
        touch += 1
        solver = unit.solver(step.indenter)
        for pose, judged in zip(step.poses, step.judged, strict=True):
            solver.advance(pose)
            yield Moment(unit, solver.displacement, touch, pose, judged, solver)
