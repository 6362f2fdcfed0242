"""Contact states for judging inverse FEM: surface displacement and the nodal forces that caused it. SIMULATED.

Truth comes from `ruffini.sim`: quadratic elements, finer than any operator and not nested in its grid,
unilateral contact with friction solved to equilibrium, at small or at finite strain. Nothing here knows an
estimator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.estimators.operator.marker_lattice import marker_places
from ruffini.sim.cache import cached_state
from ruffini.sim.contact import ContactSolver, Indenter, Pose, advance_together
from ruffini.sim.response import Response
from ruffini.sim.settings import MeshSettings, Strain, load_twin
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
        return bool(self.touches) and all(t.friction is not None and t.friction <= NO_FRICTION for t in self.touches)


@dataclass(frozen=True)
class State:
    """Truth of one state on the board's node grid: force (n_y, n_x, 3) N, displacement (n_y, n_x, 3) m.

    `at_markers` is the displacement of the board's markers, (lattice rows, columns, 3) m; None without markers.
    """

    recipe: Recipe
    depth_mm: float
    force: Array
    displacement: Array
    at_markers: Array | None = None

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

# How sure the estimate is gets judged on these: shapes and places that nothing was chosen on.
FRESH = (
    Recipe("ball", (Touch("sphere", 4.5, 2.7, -3.3),)),
    Recipe("ball sheared", (Touch("sphere", 9, -1.9, -1.5, shift=(0.0, -0.15)),)),
    Recipe("ball sliding", (Touch("sphere", 6.5, 3.1, 1.9, shift=(-0.7, 0.6)),)),
    Recipe("ball dragged", (Touch("sphere", 5.5, -4.4, 2.2, shift=(0.2, -0.25)),)),
    Recipe("flat", (Touch("flat", 2.2, -3.4, 1.6),)),
    Recipe("flat twisted", (Touch("flat", 1.6, 1.8, 3.1, turn=0.12),)),
    Recipe("square", (Touch("square", 1.9, 0.9, -1.8),)),
    Recipe("square sheared", (Touch("square", 1.7, -2.2, 2.7, shift=(0.12, 0.05)),)),
    Recipe("triangle twisted", (Touch("triangle", 2.2, -1.1, -2.4, turn=-0.1),)),
    Recipe("cylinder", (Touch("cylinder", 2.0, -0.6, 0.4),)),
    Recipe("cone", (Touch("cone", 3.0, 2.2, 0.6),)),
    Recipe("ball and square", (Touch("sphere", 5, -3.9, -1.2), Touch("square", 1.5, 3.7, 0.9, shift=(0.0, 0.1)))),
)  # fmt: skip

# On all lists above the growth of the stated uncertainty was chosen (fem.finite_strain.LINEAR_GROWTH), ...
MORE = (
    Recipe("ball", (Touch("sphere", 5.2, -2.3, 2.9),)),
    Recipe("ball sheared", (Touch("sphere", 7.6, 2.4, -1.1, shift=(0.11, 0.07)),)),
    Recipe("ball sliding", (Touch("sphere", 5.8, -3.3, -2.1, shift=(0.5, -0.8)),)),
    Recipe("ball turned", (Touch("sphere", 8.4, 0.7, 1.6, turn=0.15),)),
    Recipe("flat", (Touch("flat", 1.9, 3.6, -2.2),)),
    Recipe("flat sheared", (Touch("flat", 2.7, -1.5, -1.3, shift=(0.08, -0.14)),)),
    Recipe("square", (Touch("square", 2.2, -2.9, 0.3),)),
    Recipe("square twisted", (Touch("square", 1.8, 1.6, 2.2, turn=-0.09),)),
    Recipe("triangle", (Touch("triangle", 2.0, 2.1, -0.9, shift=(-0.1, 0.06)),)),
    Recipe("cylinder sheared", (Touch("cylinder", 2.3, 1.1, 0.8, shift=(0.13, 0.0)),)),
    Recipe("cone", (Touch("cone", 2.8, -1.9, -1.6),)),
    Recipe("two balls", (Touch("sphere", 4.6, -4.1, 1.4), Touch("sphere", 5.4, 3.8, -1.7, shift=(0.0, -0.12)))),
)  # fmt: skip
# ... and on these, which nothing was chosen on, it is judged (tests/bench/faults_stated.py).
UNSEEN = (
    Recipe("ball", (Touch("sphere", 6.3, 3.4, 1.2),)),
    Recipe("ball sheared", (Touch("sphere", 5.1, -2.9, -2.6, shift=(-0.13, 0.04)),)),
    Recipe("ball sliding", (Touch("sphere", 7.2, -1.2, 2.3, shift=(0.9, 0.3)),)),
    Recipe("ball dragged", (Touch("sphere", 8.7, 1.7, -1.9, shift=(0.05, 0.3)),)),
    Recipe("flat", (Touch("flat", 2.4, 2.6, 2.4),)),
    Recipe("flat twisted", (Touch("flat", 2.1, -3.1, -0.8, turn=-0.11),)),
    Recipe("square", (Touch("square", 2.0, -1.6, 1.9),)),
    Recipe("square sheared", (Touch("square", 1.6, 2.8, -2.3, shift=(-0.07, 0.11)),)),
    Recipe("triangle twisted", (Touch("triangle", 2.3, 0.6, 1.1, turn=0.12),)),
    Recipe("cylinder", (Touch("cylinder", 1.8, 0.4, -0.5),)),
    Recipe("cone", (Touch("cone", 3.2, -2.4, 1.3),)),
    Recipe("ball and flat", (Touch("sphere", 4.8, 3.6, -1.4), Touch("flat", 1.7, -3.9, 1.6, shift=(0.06, -0.08)))),
)  # fmt: skip


def make_states(
    board: Board,
    recipes: tuple[Recipe, ...],
    depths_mm: tuple[float, ...],
    error: PadError | None = None,
    *,
    truth: Strain = "linear",
    mesh: MeshSettings | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[State]:
    """Solve every recipe at every depth. At finite strain that takes a minute a state, once: they are cached.

    `mesh`: instead of the twin's own.

    Two indenters at once are, on a linear pad, the sum of their tractions: an exact truth for the field, if
    not exactly the balls' own shape where they disturb each other. At finite strain they go down together.

    Raises
    ------
    InputError
        The board has no twin, or an indenter does not fit its pad.
    """
    twin = load_twin(board).with_pad(strain=truth, is_relaxing=False)
    twin = twin if mesh is None else twin.model_copy(update={"mesh": mesh})
    share = 0.5 if truth == "linear" else 0.05
    unit = TwinUnit.build(board, error, twin=twin, progress=lambda done: progress(done * share))
    states = []
    for i, recipe in enumerate(recipes):
        for k, depth in enumerate(depths_mm):
            solved = _superposed(unit, recipe, depth) if truth == "linear" else _together(unit, recipe, depth)
            states.append(State(recipe, depth, solved["force"], solved["displacement"], solved.get("at_markers")))
            progress(share + (1 - share) * (i + (k + 1) / len(depths_mm)) / len(recipes))
    return states


def _superposed(unit: TwinUnit, recipe: Recipe, depth_mm: float) -> dict[str, Array]:
    """Each indenter alone on a linear pad, and the sum."""
    solvers = []
    for touch in recipe.touches:
        solver = _solver(unit, touch, unit.response())
        for pose in _path(touch, depth_mm):
            solver.advance(pose)
        solvers.append(solver)
    hats = np.sum([solver.hat_force for solver in solvers], axis=0)
    nodal = np.sum([solver.nodal_force for solver in solvers], axis=0)
    return on_board(unit, hats, (unit.compliance @ nodal.ravel()).reshape(-1, 3))


def _together(unit: TwinUnit, recipe: Recipe, depth_mm: float) -> dict[str, Array]:
    """All indenters on one pad at finite strain."""

    def solve() -> dict[str, Array]:
        response = unit.response()
        solvers = [_solver(unit, touch, response) for touch in recipe.touches]
        paths = [_path(touch, depth_mm) for touch in recipe.touches]
        for k in range(max(len(path) for path in paths)):
            advance_together(solvers, [path[min(k, len(path) - 1)] for path in paths])
        return on_board(unit, np.sum([solver.hat_force for solver in solvers], axis=0), response.surface)

    board, friction = unit.board, unit.twin.unit.friction_1e3
    places = None if board.markers is None else [line.tolist() for line in marker_places(board, board.markers)]
    key = ("along the normal", unit.model, friction, recipe.touches, depth_mm, board.grid.n_x, board.grid.n_y, places)
    return cached_state(repr(key), solve)


def on_board(unit: TwinUnit, hats: Array, displacement: Array) -> dict[str, Array]:
    board = unit.board
    force = on_grid(unit.model, hats, board.grid.n_x, board.grid.n_y)
    out = {"force": force, "displacement": unit.at_nodes(displacement)}
    if board.markers is not None:
        out["at_markers"] = unit.at_places(displacement, *marker_places(board, board.markers))
    return out


def _solver(unit: TwinUnit, touch: Touch, response: Response) -> ContactSolver:
    friction = unit.twin.unit.friction_1e3 * 1e-3 if touch.friction is None else touch.friction
    return ContactSolver(unit.model, response, Indenter(touch.shape, touch.radius * MM), friction)


def _path(touch: Touch, depth_mm: float) -> list[Pose]:
    """Down, then sideways and round."""
    t, down = touch, Pose(touch.x * MM, touch.y * MM, depth_mm * MM)
    if not (t.turn or any(t.shift)):
        return [down]
    return [down, Pose((t.x + t.shift[0]) * MM, (t.y + t.shift[1]) * MM, depth_mm * MM, t.turn)]
