"""Contact states for judging inverse FEM: surface displacement and the nodal forces that caused it. SIMULATED.

Truth comes from `ruffini.sim`: quadratic elements, finer than any operator and not nested in its grid,
unilateral contact with friction solved to equilibrium. Nothing here knows an estimator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.surface import on_grid
from ruffini.sim.unit import PadError, TwinUnit

Array = npt.NDArray[np.float64]

MM = 1e-3
NO_FRICTION = 1e-9
LIGHT_N = 0.5  # states of less force are not in the figures, as in the paper's range of 0.5-5 N


@dataclass(frozen=True)
class Touch:
    """One indenter: lengths in mm; it is pressed to the state's depth, then moved by `shift` and turned."""

    shape: str
    radius: float
    x: float
    y: float
    shift: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0
    friction: float | None = None  # of the board's twin where None


@dataclass(frozen=True)
class Recipe:
    """A state: what touches, and what kind of load it is ("pure" normal load has no friction)."""

    name: str
    touches: tuple[Touch, ...]

    @property
    def is_pure(self) -> bool:
        return all(t.friction is not None and t.friction <= NO_FRICTION for t in self.touches)


@dataclass(frozen=True)
class State:
    """Truth of one state on the board's node grid: force (n_y, n_x, 3) N, displacement (n_y, n_x, 3) m."""

    recipe: Recipe
    depth_mm: float
    force: Array
    displacement: Array

    @property
    def resultant_n(self) -> float:
        return float(np.linalg.norm(self.force.sum(axis=(0, 1))))


# For a pad of about 20 x 16 mm. Judged on the first list, weights are chosen on the second.
JUDGED = (
    Recipe("ball", (Touch("sphere", 6, 0.3, -0.2),)),
    Recipe("ball, no friction", (Touch("sphere", 8, -0.7, 0.4, friction=NO_FRICTION),)),
    Recipe("ball off centre", (Touch("sphere", 5, 4.1, -2.7),)),
    Recipe("ball at the edge", (Touch("sphere", 8, -6.2, 4.2),)),
    Recipe("flat", (Touch("flat", 2.5, -1.2, 0.7),)),
    Recipe("flat, no friction", (Touch("flat", 2.0, 1.2, 0.7, friction=NO_FRICTION),)),
    Recipe("ball sliding", (Touch("sphere", 6, -2.0, 1.0, shift=(1.0, 0.5)),)),
    Recipe("ball sheared", (Touch("sphere", 7, 0.0, 2.0, shift=(0.15, -0.1)),)),
    Recipe("flat sheared", (Touch("flat", 2.0, 2.0, 1.0, shift=(-0.2, 0.1)),)),
    Recipe("flat twisted", (Touch("flat", 2.5, 0.4, -1.0, turn=0.1),)),
    Recipe("two balls", (Touch("sphere", 5, -3.6, 0.0), Touch("sphere", 4, 3.6, 0.5, shift=(0.1, 0.0)))),
    Recipe(
        "two sliding apart",
        (Touch("sphere", 4, -2.8, -1.0, shift=(-0.8, 0.0)), Touch("sphere", 4, 2.8, -1.2, shift=(0.8, 0.3))),
    ),
)  # fmt: skip
TUNED = (
    Recipe("ball", (Touch("sphere", 7, -1.3, 1.2),)),
    Recipe("ball, no friction", (Touch("sphere", 6, 1.3, -1.2, friction=NO_FRICTION),)),
    Recipe("flat sheared", (Touch("flat", 3.0, 1.2, -0.7, shift=(0.0, 0.1)),)),
    Recipe("ball sliding", (Touch("sphere", 8, 1.0, -1.0, shift=(-1.0, 0.5)),)),
    Recipe("flat twisted", (Touch("flat", 2.2, -2.4, 1.0, turn=0.08),)),
)


def make_states(
    board: Board,
    recipes: tuple[Recipe, ...],
    depths_mm: tuple[float, ...],
    error: PadError | None = None,
    *,
    progress: Callable[[float], None] = lambda _: None,
) -> list[State]:
    """Solve every recipe at every depth.

    Two indenters at once are the sum of their tractions on one linear pad: an exact truth for the
    field, if not exactly the balls' own shape where they disturb each other.
    """
    unit = TwinUnit.build(board, error, progress=lambda done: progress(done / 2))
    states = []
    for i, recipe in enumerate(recipes):
        solvers = [_Path(unit, touch) for touch in recipe.touches]
        for depth in depths_mm:
            hats = np.sum([solver.press(depth) for solver in solvers], axis=0)
            nodal = np.sum([solver.nodal for solver in solvers], axis=0)
            displacement = (unit.compliance @ nodal.ravel()).reshape(-1, 3)
            force = on_grid(unit.model, hats, board.grid.n_x, board.grid.n_y)
            states.append(State(recipe, depth, force, unit.at_nodes(displacement)))
        progress(0.5 + (i + 1) / len(recipes) / 2)
    return states


class _Path:
    """One indenter that comes anew for every depth."""

    def __init__(self, unit: TwinUnit, touch: Touch) -> None:
        self.unit, self.touch = unit, touch
        self.nodal: Array = np.zeros(0)

    def press(self, depth_mm: float) -> Array:
        """Tractions' forces of the hats, (n, 3) N, at the end of the path to this depth."""
        t = self.touch
        friction = self.unit.twin.unit.friction_1e3 * 1e-3 if t.friction is None else t.friction
        solver = ContactSolver(self.unit.model, self.unit.compliance, Indenter(t.shape, t.radius * MM), friction)
        solver.advance(Pose(t.x * MM, t.y * MM, depth_mm * MM))
        if t.turn or any(t.shift):
            end = Pose((t.x + t.shift[0]) * MM, (t.y + t.shift[1]) * MM, depth_mm * MM, t.turn)
            solver.advance(end)
        self.nodal = solver.nodal_force
        return solver.hat_force.copy()
