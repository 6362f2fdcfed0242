"""Large strain: errors of the board's integers on a neo-Hookean pad, and the fit of what makes them small. SIMULATED.

    python tests/bench/large_strain.py --table docs/results/accuracy.md  # on FRESH, which the fit has never seen
    python tests/bench/large_strain.py --fit                             # prints what fem.finite_strain has fitted

--table replaces the rows in that document's section SECTION.

The first time either takes an hour of one core: the twin's presses at finite strain, which are cached. Presses that
the twin cannot solve (edges 1.5 mm deep) are left out and named.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gels import with_row
from scipy.optimize import lsq_linear

from ruffini.bench import ifem
from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.bench.states import FRESH, MM, NO_FRICTION, Recipe, State, Touch, make_states, on_board
from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.errors import RuffiniError
from ruffini.estimators.operator.error_model import FACTOR_Q20, N_TOUCHES, node_places
from ruffini.estimators.operator.fit import OperatorKind, board_slab, make_operator
from ruffini.fem.condense import condense, surface_stiffness
from ruffini.fem.finite_strain import (
    EXACT,
    FITTED,
    FITTED_GROWTH,
    LAYERS,
    UNWEIGHTED_GROWTH,
    ErrorGrowth,
    Weights,
    error_growth,
    finite_strain,
)
from ruffini.fem.operators import Noise
from ruffini.fem.support import contact_mask, solve_on_support
from ruffini.fem.uncertainty import NodeSample, at_stake, fit_variance
from ruffini.files import write_whole
from ruffini.reflection import dense_from_blocks, spd_inverse
from ruffini.sim.cache import cached_state
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit
from ruffini.wire.covariance import full_covariance

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
from table import commit

SECTION = "## Large strain"
COLUMNS = ("tangential error, total force", "0.6 mm", "1.0 mm", "1.5 mm", "commit", "date")
# The code that the figures depend on: commits of anything else change none.
JUDGED = ("firmware", "host/ruffini", "boards", "tests/bench/large_strain.py", ":!*.md")

Array = npt.NDArray[np.float64]
Estimate = Callable[[Array], Array]

DEPTHS_MM = (0.6, 1.0, 1.5)
NOISE = Noise((5e-6, 5e-6, 20e-6), long_share=(0.0, 0.0, 0.0))
# What is fitted on: down to a depth, aside and round (mm, radian), deeper, aside: a state after each way.
PRESSES: tuple[tuple[Touch, tuple[tuple[float, float, float], ...]], ...] = (
    (Touch("sphere", 7, -1.3, 1.2), ((0, 0, 0),) * 3),
    (Touch("sphere", 6, 1.3, -1.2, friction=NO_FRICTION), ((0, 0, 0),) * 3),
    (Touch("flat", 3.0, 1.2, -0.7), ((0, 0.1, 0), (0.1, 0.15, 0), (0.15, 0.2, 0))),
    (Touch("sphere", 8, 1.0, -1.0), ((-1.0, 0.5, 0), (-1.6, 0.9, 0), (-0.8, 1.6, 0))),
    (Touch("flat", 2.2, -2.4, 1.0), ((0, 0, 0.08), (0, 0, 0.12), (0, 0, 0.12))),
    (Touch("sphere", 4, 2.0, 0.5), ((0.1, 0, 0), (0.2, 0, 0), (0.3, 0, 0))),
    (Touch("cylinder", 2.5, 0.5, -0.8), ((0, 0, 0), (0.2, 0, 0), (0.2, 0.3, 0))),
    (Touch("square", 2.4, -1.0, 0.5), ((-0.1, 0, 0), (-0.2, 0.1, 0.05), (-0.2, 0.1, 0.1))),
)
SEED = 1
FIT_STEP, PRIOR = 0.2, 0.1  # of the weights' differences; of the start's own information
FIT_RANGE = (0.05, 8.0)
LEAST_SHEAR, TOTAL_WEIGHT = 0.15, 5.0  # of the force; of the total force's error


def pressed(unit: TwinUnit, touch: Touch, moves: tuple[tuple[float, float, float], ...]) -> Iterator[State]:
    """States along one way on a pad at finite strain, until the twin finds no equilibrium."""
    friction = unit.twin.unit.friction_1e3 * 1e-3 if touch.friction is None else touch.friction

    def poses() -> Iterator[tuple[float, Pose]]:
        last = (0.0, 0.0, 0.0)
        for depth, move in zip(DEPTHS_MM, moves, strict=True):
            for x, y, turn in dict.fromkeys((last, move)):
                yield depth, Pose((touch.x + x) * MM, (touch.y + y) * MM, depth * MM, float(turn))
            last = move

    solver: ContactSolver | None = None
    done: list[Pose] = []

    def solve() -> dict[str, Array]:
        nonlocal solver
        if solver is None:
            indenter = Indenter(touch.shape, touch.radius * MM)
            solver = ContactSolver(unit.model, unit.response(), indenter, friction)
            for before in done:
                solver.advance(before)
        solver.advance(pose)
        return on_board(unit, solver.hat_force, solver.response.surface)

    for depth, pose in poses():
        out = attempt(repr(("a way", unit.model, friction, touch, done, pose)), solve)
        if not out:
            print(f"  {touch.shape} of {touch.radius:g} mm, {depth:g} mm deep: not solved", file=sys.stderr)
            return
        done.append(pose)
        print(f"  {touch.shape} of {touch.radius:g} mm, {depth:g} mm deep", file=sys.stderr)
        yield State(Recipe(touch.shape, (touch,)), depth, out["force"], out["displacement"])


def attempt(key: str, solve: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """What `solve` gives, or nothing where the twin finds no equilibrium; both from the cache."""

    def tried() -> dict[str, Array]:
        try:
            return solve()
        except (RuffiniError, np.linalg.LinAlgError):
            return {}

    return cached_state(key, tried)


def fitted_on(board: Board) -> list[list[State]]:
    """The states of each of PRESSES, as far as the twin solves them."""
    unit = TwinUnit.build(board, twin=load_twin(board).with_pad(strain="finite", is_relaxing=False))
    return [list(pressed(unit, touch, moves)) for touch, moves in PRESSES]


def growth(board: Board, presses: list[list[State]], weights_for: Callable[[list[State]], Weights]) -> ErrorGrowth:
    """Factors on the touches' variances with which the board's sigmas are what they should be, and the crosstalk.

    `weights_for` gets the states of all other presses than the one that is judged.
    """
    step_n, places = board.field.force_lsb_un * 1e-6, node_places(board_slab(board), board.observed)
    fitted_pad = make_operator(
        board, method="support", noise=NOISE, n_touches=N_TOUCHES, is_finite=True, is_fitted=True
    )  # its own error is in the error model
    rng, noise = np.random.default_rng(SEED), Disturbance(white_um=WHITE_UM)
    ratios: dict[str, list[Array]] = {name: [] for name in ("shear", "normal", "wrench")}
    leaks: list[tuple[Array, Array, float]] = []  # errors of fx and fy, their variances, fz
    for i, left_out in enumerate(presses):
        weights = weights_for([state for press in presses[:i] + presses[i + 1 :] for state in press])
        with contextlib.closing(_pipeline(board, weighted(board, fitted_pad, weights))) as pipeline:
            for state in left_out:
                force = solved(board, pipeline, state.displacement + noise.draw(state.displacement.shape, rng))
                sample = NodeSample(force / step_n, state.force / step_n)
                chosen = at_stake(sample, board.contact.threshold_un * 1e-6 / step_n)
                sigma, upper = pipeline.sigma()
                error = force - state.force
                ratio = (error / (sigma.reshape(error.shape) * step_n))[chosen]
                ratios["shear"].append(ratio[:, :2].ravel())
                ratios["normal"].append(ratio[:, 2])
                of_wrench, variance = places.wrench(error, np.zeros(2)), np.diag(full_covariance(upper))
                ratios["wrench"].append((of_wrench / np.sqrt(variance))[2:])
                leaks.append((of_wrench[:2], variance[:2], float(state.force[..., 2].sum())))
    now = vars(error_growth(board_slab(board)))  # the sigmas have it already
    found = {name: np.concatenate(parts) for name, parts in ratios.items()}
    more = {n: float(fit_variance(np.ones((len(r), 1)), r)[0]) for n, r in found.items()}
    pressing = np.repeat([fz for *_, fz in leaks], 2)
    held = fitted_pad.tensors["support.error_crosstalk"][0] / FACTOR_Q20
    known = more["wrench"] * (np.concatenate([v for _, v, _ in leaks]) - (held * pressing) ** 2)
    crosstalk = fit_variance(pressing[:, None] ** 2, np.concatenate([e for e, _, _ in leaks]), np.maximum(known, 0))
    return ErrorGrowth(**{n: now[n] * m for n, m in more.items()}, crosstalk=float(np.sqrt(crosstalk[0])))


def fit(board: Board, states: list[State]) -> Weights:
    """Weights with which the float second pass errs least; one linearised step from the best displacement.

    The step keeps near the start, whose errors are those of the displacement that a linear pad would have.
    """
    kind, condensed = make_operator(board, method="support", noise=NOISE, is_finite=True), condense(board_slab(board))
    assert kind.support is not None
    assert kind.beyond is not None
    system, beyond = kind.support, kind.beyond
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(block) for block in surface_stiffness(condensed)])
    singles = [_weights(row) for row in np.eye(3 * len(LAYERS))]

    def terms(u: Array) -> Array:
        return np.stack([replace(beyond, weights=one).force(u).ravel() for one in singles], axis=1)

    def second_pass(u: Array, part: Array) -> Array:
        linear = kind.matrix @ u.ravel() + part
        mask, least_n = contact_mask(
            linear.reshape(u.shape)[..., 2], threshold_n=board.contact.threshold_un * 1e-6,
            min_nodes=board.contact.min_nodes,
        )  # fmt: skip
        return solve_on_support(system, u.ravel(), linear, mask.ravel(), threshold_n=least_n, beyond_n=part)

    rows, lacking, slopes, errors = [], [], [], []
    for state in states:
        of_weights = terms(state.displacement)
        lack = (compliance @ state.force.ravel() - state.displacement.ravel()) / np.tile(
            NOISE.sigma_m, len(kind.matrix) // 3
        )
        size = np.sqrt(np.linalg.norm(lack))
        rows.append(compliance @ of_weights / np.tile(NOISE.sigma_m, len(kind.matrix) // 3)[:, None] / size)
        lacking.append(lack / size)
    matrix = np.concatenate(rows)
    start = _bounded(matrix.T @ matrix, matrix.T @ (np.concatenate(lacking) - matrix.sum(axis=1)), np.ones(9), PRIOR)
    for i, state in enumerate(states):
        u = state.displacement + Disturbance(white_um=WHITE_UM).draw(state.displacement.shape, np.random.default_rng(i))
        of_weights = terms(u)
        at = _errors(state.force, second_pass(u, of_weights @ start))
        steps = start + FIT_STEP * np.eye(len(start))
        slopes.append(
            np.stack([_errors(state.force, second_pass(u, of_weights @ w)) - at for w in steps], axis=1) / FIT_STEP
        )
        errors.append(at)
    slope, error = np.concatenate(slopes), np.concatenate(errors)
    return _weights(_bounded(slope.T @ slope, -slope.T @ error, start, PRIOR))


def _weights(values: Array) -> Weights:
    return Weights(*(tuple(float(v) for v in part) for part in values.reshape(3, -1)))


def _bounded(information: Array, gradient: Array, start: Array, prior: float) -> Array:
    """start + x within FIT_RANGE, where x minimises x^T (I + prior diag I) x / 2 - gradient x."""
    root = np.linalg.cholesky(information + prior * np.diag(np.diag(information)))
    low, high = FIT_RANGE
    return np.asarray(start + lsq_linear(root.T, np.linalg.solve(root, gradient), (low - start, high - start)).x)


def _errors(true: Array, force: Array) -> Array:
    """Shear, pressure and total force, each over its own size."""
    error, size = force.reshape(true.shape) - true, float(np.linalg.norm(true))
    shear = max(float(np.linalg.norm(true[..., :2])), LEAST_SHEAR * size)
    total = float(np.linalg.norm(true.sum(axis=(0, 1)))) / TOTAL_WEIGHT
    parts = (error[..., :2] / shear, error[..., 2] / np.linalg.norm(true[..., 2]), error.sum(axis=(0, 1)) / total)
    return np.concatenate([part.ravel() for part in parts])


def judge(board: Board) -> dict[str, list[str]]:
    """Print the errors of the board's integers on FRESH. Returns the cells of the rows' depths, by the row's name."""
    rows: dict[str, list[str]] = {}
    kind = make_operator(board, method="support", noise=NOISE, is_finite=True)
    plain = replace(kind, tensors={k: v for k, v in kind.tensors.items() if not k.startswith("finite_strain.")})
    linear, others = _pipeline(board, plain), {
        "second order": weighted(board, kind, EXACT), "`--strain finite`": kind,
    }  # fmt: skip
    for depth in DEPTHS_MM:
        states, unsolved = [], []
        for recipe in FRESH:

            def solve(recipe: Recipe = recipe, depth: float = depth) -> dict[str, Array]:
                state = make_states(board, (recipe,), (depth,), truth="finite")[0]
                return {"force": state.force, "displacement": state.displacement}

            out = attempt(repr(("large strain", board_slab(board), recipe, depth)), solve)
            if out:
                states.append(State(recipe, depth, out["force"], out["displacement"]))
            else:
                unsolved.append(recipe.name)
        print(
            f"{depth:g} mm, SIMULATED, {len(states)} presses; not solved by the twin: {', '.join(unsolved) or 'none'}"
        )
        small = make_states(board, tuple(state.recipe for state in states), (depth,))
        for name, pipeline, judged in (
            ("linear pad, linear default", linear, small),
            ("finite strain, linear default", linear, states),
            *((f"finite strain, {name}", _pipeline(board, other), states) for name, other in others.items()),
        ):
            rows.setdefault(name, []).append(report(board, name, pipeline, judged))
    return rows


def report(board: Board, name: str, pipeline: Pipeline, states: list[State]) -> str:
    """Print the mean errors of the board's integers, with noise. Returns a table's cell."""
    scores, noise = ifem.Scores(), Disturbance(white_um=WHITE_UM)
    for i, state in enumerate(states):
        for seed in range(3):
            u = state.displacement + noise.draw(state.displacement.shape, np.random.default_rng((7, i, seed)))
            scores.add(state, solved(board, pipeline, u), step_mm(board))
    m = scores.means()
    errors = f"tangential {m['tangential']:.3f}, normal {m['normal']:.3f}, total {1e3 * m['resultant_n']:.0f} mN"
    print(f"  {name:34}{errors}", flush=True)
    return f"{m['tangential']:.2f}, {1e3 * m['resultant_n']:.0f} mN"


def step_mm(board: Board) -> tuple[float, float]:
    pad, grid = board.pad, board.grid
    return pad.size_x_um * 1e-3 / (grid.n_x - 1), pad.size_y_um * 1e-3 / (grid.n_y - 1)


def weighted(board: Board, kind: OperatorKind, weights: Weights) -> OperatorKind:
    """An operator for finite strain with other weights."""
    beyond = finite_strain(board_slab(board), (board.grid.n_y, board.grid.n_x), weights)
    tables, integers = beyond.tensors(board.field.force_lsb_un)
    return replace(kind, tensors=kind.tensors | tables, metadata=kind.metadata | integers)


def solved(board: Board, pipeline: Pipeline, displacement_m: Array) -> Array:
    """The board's nodal forces (n_y, n_x, 3) N."""
    steps = np.round(displacement_m / DISPLACEMENT_LSB_M).astype(np.int16)
    force = pipeline.solve(steps.reshape(1, -1, 3)) * (board.field.force_lsb_un * 1e-6)
    return np.asarray(force.reshape(displacement_m.shape), np.float64)


def _pipeline(board: Board, kind: OperatorKind) -> Pipeline:
    return Pipeline(board, container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="gelslim", help="a board with a flat pad and a window as large as it")
    parser.add_argument("--fit", action="store_true", help="fit the weights and the growth of the errors instead")
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the rows into this document")
    chosen = parser.parse_args()
    board = find_board(chosen.board)
    if chosen.fit:
        presses = fitted_on(board)
        print(f"fitted: {fit(board, [state for press in presses for state in press])}\nnow:    {FITTED}", flush=True)
        print(
            f"fitted: {growth(board, presses, lambda others: fit(board, others))}\nnow:    {FITTED_GROWTH}", flush=True
        )
        print(f"second order: {growth(board, presses, lambda _: EXACT)}\nnow:          {UNWEIGHTED_GROWTH}")
        return
    at, date = commit(JUDGED), datetime.date.today().isoformat()
    rows = judge(board)
    if chosen.table is not None:
        text = chosen.table.read_text()
        for name, cells in rows.items():
            text = with_row(text, f"| {' | '.join((name, *cells, at, date))} |", SECTION, COLUMNS)
        write_whole(chosen.table, text.encode())


if __name__ == "__main__":
    main()
