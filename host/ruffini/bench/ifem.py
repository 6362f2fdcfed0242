"""The inverse-FEM benchmark: iFEM raw, sparse and ridge of the papers, our linear estimate, our default. SIMULATED.

Every baseline has the same mesh and layers as ours and its own best weight, chosen on states that are
not judged. "default" is what the board computes: the integers of the compiled tables, second pass included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench import bad_nodes, coverage, fitted, objects, resolution, window
from ruffini.bench.bad_nodes import BadNodes
from ruffini.bench.disturbance import HALF_WHITE_UM, WHITE_UM, Disturbance
from ruffini.bench.markers import LostMarkers
from ruffini.bench.states import JUDGED, LIGHT_N, TUNED, UNSEEN, State, make_states
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, NOT_MEASURED, Pipeline
from ruffini.errors import InputError
from ruffini.estimators.operator.error_model import N_TOUCHES, node_places
from ruffini.estimators.operator.fit import OperatorKind, board_slab, make_operator, second_pass
from ruffini.estimators.operator.marker_lattice import NodesOnLattice
from ruffini.fem.condense import condense
from ruffini.fem.operators import Noise, ridge_operator
from ruffini.fem.sparse import SparseEstimator
from ruffini.reflection import dense_from_blocks
from ruffini.sim.settings import Strain
from ruffini.sim.unit import PadError
from ruffini.tables import aligned
from ruffini.wire.covariance import full_covariance

Array = npt.NDArray[np.float64]
Estimate = Callable[[Array], Array]
Progress = Callable[[float], None]

RIDGE_WEIGHTS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
SPARSE_WEIGHTS = (1e-5, 1e-4, 1e-3, 1e-2)
MODEL_ERRORS = {
    "E +5 %": PadError(modulus=1.05),
    "nu +2 %": PadError(poisson=1.02),
    "thickness +5 %": PadError(thickness=1.05),
}
LINEAR = "default, linear"  # the default without finite strain
SHAPE_LEVEL = 0.1  # of the peak pressure: where a contact's shape ends


@dataclass
class Scores:
    """Errors of one method over states and seeds; each list has one number a state and seed."""

    x: list[float] = field(default_factory=list)
    y: list[float] = field(default_factory=list)
    tangential: list[float] = field(default_factory=list)
    normal: list[float] = field(default_factory=list)
    false_shear: list[float] = field(default_factory=list)
    resultant_n: list[float] = field(default_factory=list)
    moment_nmm: list[float] = field(default_factory=list)
    shape: list[float] = field(default_factory=list)
    peak: list[float] = field(default_factory=list)

    def add(self, state: State, force: Array, step_mm: tuple[float, float]) -> None:
        """Score an estimate (n_y, n_x, 3), newtons, against a state's truth."""
        true, error = state.force, force - state.force
        size = float(np.linalg.norm(true))
        if state.recipe.is_pure:
            # At finite strain even a slippery ball pushes sideways, along its normal: that is no false shear.
            self.false_shear.append(float(np.linalg.norm(error[..., :2]) / np.linalg.norm(force[..., 2])))
        else:
            # Against the state's own shear: a ball pressed straight has little, and counts as much.
            self.x.append(_relative(error[..., 0], true[..., 0], size))
            self.y.append(_relative(error[..., 1], true[..., 1], size))
            self.tangential.append(_relative(error[..., :2], true[..., :2], size))
        self.normal.append(float(np.linalg.norm(error[..., 2]) / np.linalg.norm(true[..., 2])))
        self.resultant_n.append(float(np.linalg.norm(error.sum(axis=(0, 1)))))
        self.moment_nmm.append(float(np.linalg.norm(_moment_nmm(error, step_mm))))
        touched = [f[..., 2] < SHAPE_LEVEL * np.min(true[..., 2]) for f in (force, true)]
        self.shape.append(float((touched[0] & touched[1]).sum() / max((touched[0] | touched[1]).sum(), 1)))
        self.peak.append(float(np.min(force[..., 2])) / float(np.min(true[..., 2])))

    def means(self) -> dict[str, float]:
        return {name: float(np.mean(values)) for name, values in vars(self).items() if values}


def _relative(error: Array, true: Array, size: float) -> float:
    """Relative L2 error; of a component with next to no truth against 5 % of the whole force."""
    return float(np.linalg.norm(error)) / max(float(np.linalg.norm(true)), 0.05 * size)


def _moment_nmm(force: Array, step_mm: tuple[float, float]) -> Array:
    n_y, n_x = force.shape[:2]
    x = (np.arange(n_x) - (n_x - 1) / 2) * step_mm[0]
    y = (np.arange(n_y) - (n_y - 1) / 2) * step_mm[1]
    fx, fy, fz = np.moveaxis(force, -1, 0)
    return np.array([(y[:, None] * fz).sum(), -(x * fz).sum(), (x * fy - y[:, None] * fx).sum()])


class Methods:
    """Each method: displacement (n_y, n_x, 3) m -> nodal force (n_y, n_x, 3) N, of a board whose window is its pad.

    "default" adds what finite strain makes where the `truth` is at finite strain; "default, linear" does not.
    long_share: of the noise, where the calibration knows it (`fem.operators.Noise`).
    """

    def __init__(
        self, board: Board, truth: Strain = "linear", *, long_share: tuple[float, float, float] | None = None,
        progress: Progress = lambda _: None,
    ) -> None:  # fmt: skip
        self.board = board
        self.shape = (board.grid.n_y, board.grid.n_x, 3)
        slab = board_slab(board)
        self.places = node_places(slab, board.observed)
        self._condensed = condense(slab)
        noise = Noise((5e-6, 5e-6, 20e-6), long_share=long_share)
        linear = make_operator(board, method="optimal", noise=noise)
        progress(0.3)
        made = partial(make_operator, board, method="support", noise=noise, n_touches=N_TOUCHES)
        default = made(is_fitted=True)
        progress(0.6)
        self._linear_pipeline = _pipeline(board, default)
        self._pipeline = self._linear_pipeline
        self._fitted = {"linear": self._linear_pipeline}
        self._not_fitted = cache(lambda: _pipeline(board, made()))
        if truth == "finite":
            self._pipeline = self._fitted["finite"] = _pipeline(board, made(is_fitted=True, is_finite=True))
        assert default.support is not None
        self._second_pass = second_pass(board, default.matrix, default.support)
        self._linear = linear.matrix
        self._ridge = {
            w: dense_from_blocks(self._condensed.bases, ridge_operator(self._condensed, w))
            for w in (0.0, *RIDGE_WEIGHTS)
        }
        progress(0.9)
        self._sparse = SparseEstimator(self._condensed)
        self.ridge_weight = RIDGE_WEIGHTS[0]
        self.sparse_weight = SPARSE_WEIGHTS[0]
        progress(1.0)

    def close(self) -> None:
        for pipeline in self._fitted.values():
            pipeline.close()
        if self._not_fitted.cache_info().currsize:
            self._not_fitted().close()

    def tune(self, states: list[State], disturbance: Disturbance, rng: np.random.Generator) -> None:
        """Each baseline's own best weight on these states: least sum of tangential and normal error."""
        noisy = [s.displacement + disturbance.draw(self.shape, rng) for s in states]

        def cost(estimate: Estimate) -> float:
            scores = Scores()
            for state, u in zip(states, noisy, strict=True):
                scores.add(state, estimate(u), self.step_mm)
            means = scores.means()
            return means["tangential"] + means["normal"]

        self.ridge_weight = min(RIDGE_WEIGHTS, key=lambda w: cost(lambda u: self._apply(self._ridge[w], u)))
        self.sparse_weight = min(SPARSE_WEIGHTS, key=lambda w: cost(lambda u: self._sparse_force(u, w)))

    @property
    def step_mm(self) -> tuple[float, float]:
        pad, grid = self.board.pad, self.board.grid
        return pad.size_x_um * 1e-3 / (grid.n_x - 1), pad.size_y_um * 1e-3 / (grid.n_y - 1)

    def all(self) -> dict[str, Estimate]:
        estimates: dict[str, Estimate] = {
            "raw": lambda u: self._apply(self._ridge[0.0], u),
            "sparse": lambda u: self._sparse_force(u, self.sparse_weight),
            "ridge": lambda u: self._apply(self._ridge[self.ridge_weight], u),
            "optimal": lambda u: self._apply(self._linear, u),
        }
        if self._pipeline is not self._linear_pipeline:
            estimates[LINEAR] = partial(self._as_the_board, self._linear_pipeline)
        return estimates | {"default": partial(self._as_the_board, self._pipeline)}

    def _apply(self, matrix: Array, u: Array) -> Array:
        return np.asarray((matrix @ u.ravel()).reshape(self.shape))

    def _sparse_force(self, u: Array, weight: float) -> Array:
        return self._sparse.force(u.reshape(-1, 1), weight).reshape(self.shape)

    def with_bad_nodes(self) -> dict[str, Estimate]:
        """The board, and the peers against nodes that are wrong or missing (NaN)."""
        rough = bad_nodes.peers(lambda u: self._second_pass(u)[0])
        return rough | {"default": partial(self._as_the_board, self._linear_pipeline)}

    def stated(self, u: Array, *, is_fitted: bool = True, strain: Strain = "linear") -> coverage.Stated:
        """Force that the board makes of a displacement; its uncertainty with a fitted material or the board's.

        strain: what a board with a fitted material is calibrated for; "finite" only where the truth is.
        """
        pipeline = self._fitted[strain] if is_fitted else self._not_fitted()
        force = self._as_the_board(pipeline, u)
        sigma, upper = pipeline.sigma()
        sigma_n: Array = sigma * np.float64(self.board.field.force_lsb_un * 1e-6)
        return coverage.Stated(force, sigma_n, full_covariance(upper))

    def _as_the_board(self, pipeline: Pipeline, u: Array) -> Array:
        steps = np.clip(np.nan_to_num(np.round(u / DISPLACEMENT_LSB_M)), -32767, 32767).astype(np.int16)
        steps[np.isnan(u)] = NOT_MEASURED
        force = pipeline.solve(steps.reshape(1, -1, 3)) * (self.board.field.force_lsb_un * 1e-6)
        return np.asarray(force.reshape(self.shape))


def _pipeline(board: Board, kind: OperatorKind) -> Pipeline:
    file = container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata})
    return Pipeline(board, file.data)


def evaluate(
    methods: Methods,
    states: list[State],
    disturbance: Disturbance | LostMarkers,
    n_seeds: int,
    names: tuple[str, ...] | None = None,
) -> dict[str, dict[str, float]]:
    """Mean scores of each method; every method sees the same noise, and the same markers."""
    table = {name: Scores() for name in names or methods.all()}
    estimates = methods.all()
    for i, state in enumerate(states):
        for seed in range(n_seeds):
            u = observed(methods.board, state, disturbance, np.random.default_rng((7, i, seed)))
            for name, scores in table.items():
                scores.add(state, estimates[name](u), methods.step_mm)
    return {name: scores.means() for name, scores in table.items()}


def observed(board: Board, state: State, disturbance: Disturbance | LostMarkers, rng: np.random.Generator) -> Array:
    """What the methods see of a state, (n_y, n_x, 3) m."""
    if isinstance(disturbance, Disturbance):
        return state.displacement + disturbance.draw(state.displacement.shape, rng)
    if board.markers is None or state.at_markers is None:
        raise InputError(f"board {board.name!r} has no [markers] to lose: ask for another disturbance")
    return disturbance.observe(NodesOnLattice(board, board.markers), state.displacement, state.at_markers, rng)


def run(board: Board, *, quick: bool, truth: Strain = "linear", progress: Progress = lambda _: None) -> dict[str, Any]:
    """The whole benchmark as one nested dict; `truth` is the strain of the pad that the methods are judged on.

    Raises
    ------
    InputError
        The board has no twin, or an indenter does not fit its pad.
    """
    depths = (0.6,) if quick else (0.3, 0.6, 1.0)
    n_seeds = 1 if quick else 3
    white = Disturbance(white_um=WHITE_UM)
    methods = Methods(board, truth, progress=lambda done: progress(0.15 * done))
    try:
        tuned = make_states(board, TUNED, (0.6,), truth=truth, progress=lambda done: progress(0.15 + 0.1 * done))
        methods.tune(tuned, white, np.random.default_rng(5))
        states = make_states(board, JUDGED, depths, truth=truth, progress=lambda done: progress(0.25 + 0.2 * done))
        heavy = [s for s in states if s.resultant_n >= LIGHT_N]
        result: dict[str, Any] = {
            "board": board.name, "simulated": True, "quick": quick, "truth": truth,
            "states": len(heavy), "seeds": n_seeds, "noise_um": WHITE_UM,
            "weights": {"ridge": methods.ridge_weight, "sparse": methods.sparse_weight},
            "accuracy": {}, "objects": {}, "object": {}, "separation": {}, "strain": {},
            "noise": {}, "markers": {}, "bad_nodes": {}, "model_error": {}, "wrong_pad": {},
        }  # fmt: skip
        for depth in depths:
            chosen = [s for s in heavy if s.depth_mm == depth]
            result["accuracy"][f"{depth} mm"] = evaluate(methods, chosen, white, n_seeds)
        if truth == "linear":
            result |= beyond_balls(methods, white, n_seeds, quick=quick)
        if truth == "finite":
            result["strain"] = strain_cost(methods, heavy, make_states(board, JUDGED, depths), white, n_seeds)
        progress(0.6)
        middle = [s for s in heavy if s.depth_mm == 0.6]
        for level in (0.0, 10.0, 20.0, 40.0):
            result["noise"][f"white {level:g} um"] = evaluate(
                methods, middle, Disturbance(white_um=(level / 4, level / 4, level)), n_seeds
            )
            if level and not quick:
                result["noise"][f"correlated {level:g} um"] = evaluate(
                    methods, middle, Disturbance(correlated_um=(level / 4, level / 4, level)), n_seeds
                )
        progress(0.75)
        for share in () if board.markers is None else (0.0, 0.1) if quick else (0.0, 0.05, 0.1, 0.2):
            result["markers"][f"lost markers {100 * share:g} %"] = evaluate(
                methods, middle, LostMarkers(share, WHITE_UM), n_seeds
            )
        result["bad_nodes"] = with_bad_nodes(methods, middle, n_seeds)
        progress(0.8)
        for name, error in ({} if quick or truth == "finite" else MODEL_ERRORS).items():
            wrong = [s for s in make_states(board, JUDGED, (0.6,), error) if s.resultant_n >= LIGHT_N]
            result["model_error"][name] = evaluate(methods, wrong, white, n_seeds)
            result["wrong_pad"][name] = stated_on_wrong_pad(methods, wrong, white, n_seeds)
        result["coverage"] = coverage_of(methods, depths)
        progress(0.9)
        result["window"] = window.run(board, n_seeds=2 if quick else 6)
        result["resolution"] = resolution.part(board, quick=quick, progress=lambda done: progress(0.9 + 0.02 * done))
        if fitted.has_images(board):
            result["fitted"] = fitted.run(
                board, depths, quick=quick, progress=lambda done: progress(0.92 + 0.08 * done)
            )
        progress(1.0)
        return result
    finally:
        methods.close()


def beyond_balls(methods: Methods, disturbance: Disturbance, n_seeds: int, *, quick: bool) -> dict[str, Any]:
    """The paper's states and objects, textures, two contacts side by side; the default on each state by itself."""
    board = methods.board
    groups = {"textures": objects.textured_states(board)}
    if objects.has_paper(board):
        groups = {"the paper's states and objects": objects.paper_states(board, quick=quick), **groups}
    alone = {
        s.recipe.name: evaluate(methods, [s], disturbance, n_seeds, ("default",))["default"] | {"load_n": s.resultant_n}
        for group in groups.values()
        for s in group
    }
    rng = np.random.default_rng(13)
    return {
        "objects": {name: evaluate(methods, group, disturbance, n_seeds) for name, group in groups.items()},
        "object": alone,
        "separation": objects.separation(board, methods.all(), lambda: disturbance.draw(methods.shape, rng)),
    }


def strain_cost(
    methods: Methods, finite: list[State], linear: list[State], disturbance: Disturbance, n_seeds: int
) -> dict[str, dict[str, Any]]:
    """By depth: what the force of the pad at finite strain is over the linear one's, and what is lost to it.

    On the linear pad the linear default is judged: what the compensated one should come back to.
    """
    pairs = [(f, next(s for s in linear if (s.recipe, s.depth_mm) == (f.recipe, f.depth_mm))) for f in finite]
    out: dict[str, dict[str, Any]] = {}
    for depth in sorted({f.depth_mm for f in finite}):
        here = [(f, s) for f, s in pairs if f.depth_mm == depth]
        bent, small = (list(states) for states in zip(*here, strict=True))
        ratios = [f.resultant_n / s.resultant_n for f, s in here]
        out[f"{depth} mm"] = {
            "force_ratio": float(np.mean(ratios)), "largest_ratio": max(ratios),
            "linear pad": evaluate(methods, small, disturbance, n_seeds, (LINEAR,))[LINEAR],
            "finite strain": evaluate(methods, bent, disturbance, n_seeds, (LINEAR, "default")),
        }  # fmt: skip
    return out


def coverage_of(methods: Methods, depths: tuple[float, ...]) -> dict[str, Any]:
    """How often the truth lies within the default's sigmas, on pads fitted by `cal fit --only material` to 1 to 2 %."""
    board, rng = methods.board, np.random.default_rng(11)
    counted = coverage.Coverage(methods.places, board.field.force_lsb_un * 1e-6, board.contact.threshold_un * 1e-6)
    for error in coverage.RESIDUAL_ERRORS:
        states = [s for s in make_states(board, UNSEEN, depths, error) if s.resultant_n >= LIGHT_N]
        counted.n_states += len(states)
        for noise in (Disturbance(white_um=WHITE_UM), Disturbance(white_um=WHITE_UM, correlated_um=HALF_WHITE_UM)):
            coverage.judge(counted, methods.stated, states, partial(noise.draw, methods.shape), rng)
    return {"states": counted.n_states, "columns": counted.summary()}


def with_bad_nodes(methods: Methods, states: list[State], n_seeds: int) -> dict[str, dict[str, dict[str, float]]]:
    """By condition the mean scores of the board and its peers, with the same noise in every condition."""
    conditions = {
        "none": BadNodes(WHITE_UM),
        "3 % of the nodes off by 0.2 mm": BadNodes(WHITE_UM, share=0.03),
        "a hole of 3 mm": BadNodes(WHITE_UM, hole_mm=bad_nodes.HOLE_MM),
        "both": BadNodes(WHITE_UM, share=0.03, hole_mm=bad_nodes.HOLE_MM),
    }
    estimates = methods.with_bad_nodes()
    out: dict[str, dict[str, dict[str, float]]] = {}
    for condition, bad in conditions.items():
        scores = {name: Scores() for name in estimates}
        for i, state in enumerate(states):
            for seed in range(n_seeds):
                u = bad.observe(state.displacement, methods.step_mm, np.random.default_rng((17, i, seed)))
                for name, estimate in estimates.items():
                    scores[name].add(state, estimate(u), methods.step_mm)
        out[condition] = {name: s.means() for name, s in scores.items()}
    return out


def stated_on_wrong_pad(
    methods: Methods, states: list[State], disturbance: Disturbance, n_seeds: int
) -> dict[str, dict[str, float]]:
    """Percent of the true Fz within one and two stated sigmas, those of the board's numbers and of fitted ones."""
    out: dict[str, dict[str, float]] = {}
    for name, is_fitted in (("the board's", False), ("as if fitted", True)):
        tally = coverage.Tally()
        for i, state in enumerate(states):
            for seed in range(n_seeds):
                u = observed(methods.board, state, disturbance, np.random.default_rng((7, i, seed)))
                stated = methods.stated(u, is_fitted=is_fitted)
                error = (stated.force - state.force)[..., 2].sum()
                tally.add(np.array(error), np.sqrt(stated.covariance[2, 2]))
        out[name] = tally.summary()
    return out


def _scored(methods: dict[str, dict[str, float]]) -> list[str]:
    """A line for each method, with the load where its state has one."""
    head = ("", "tangential", "normal", "false shear", "resultant", "moment", "shape", "peak", "")
    return aligned(head, [
        (
            name, f"{m['tangential']:.3f}", f"{m['normal']:.3f}",
            f"{m['false_shear']:.4f}" if "false_shear" in m else "", f"{1e3 * m['resultant_n']:.1f} mN",
            f"{m['moment_nmm']:.2f} Nmm", f"{m['shape']:.2f}", f"{m['peak']:.2f}",
            f"of {m['load_n']:.2f} N" if "load_n" in m else "",
        )
        for name, m in methods.items()
    ], "  ")  # fmt: skip


def tables(result: dict[str, Any]) -> str:
    """The result as text."""
    weights = result["weights"]
    lines = [
        f"{result['board']}, SIMULATED, truth at {'finite' if result['truth'] == 'finite' else 'small'} strain: "
        f"{result['states']} states of at least {LIGHT_N} N, {result['seeds']} seeds; "
        f"own best weights: ridge {weights['ridge']:g}, sparse {weights['sparse']:g}",
        "tangential, normal: relative L2 error of the nodal forces; false shear: tangential error over normal force "
        "under pure normal load",
    ]
    conditions = {
        "accuracy": "noise 5/5/20 um",
        "objects": "noise 5/5/20 um",
        "noise": "0.6 mm",
        "markers": "0.6 mm, noise 5/5 um at the markers and 20 um at the nodes",
        "model_error": "0.6 mm, noise 5/5/20 um",
    }
    for title, what in conditions.items():
        for condition, methods in result[title].items():
            lines += ["", f"{condition}, {what}", *_scored(methods)]
    for condition, m in result["bad_nodes"].items():
        lines += ["", f"bad nodes: {condition}, 0.6 mm, noise 5/5/20 um", *_scored(m)]
        plain = result["bad_nodes"]["none"]
        ratios = (f"{name} {scores['tangential'] / plain[name]['tangential']:.2f}" for name, scores in m.items())
        lines += ["  tangential error over that without: " + ", ".join(ratios)]
    if result["wrong_pad"]:
        lines += ["", "true Fz within one and two stated sigmas on a wrong pad that was not fitted, 0.6 mm"]
        lines += aligned(("pad", "uncertainty", "within 1", "within 2", "mean sigma", "frames"), [
            (error, name, f"{s['within_1']:.0f} %", f"{s['within_2']:.0f} %", f"{1e3 * s['mean_sigma']:.0f} mN", s["n"])
            for error, rows in result["wrong_pad"].items() for name, s in rows.items()
        ], "  ")  # fmt: skip
    if result["object"]:
        lines += ["", "the default on each of them", *_scored(result["object"])]
        lines += ["", objects.separation_table(result["separation"])]
    for depth, cost in result["strain"].items():
        lines += [
            "",
            f"{depth}, noise 5/5/20 um: the pad at finite strain presses back {100 * cost['force_ratio'] - 100:+.1f} % "
            f"(at most {100 * cost['largest_ratio'] - 100:+.1f} %)",
        ]
        bent = cost["finite strain"]
        for name, m in (
            ("linear pad, linear default", cost["linear pad"]),
            ("finite strain, linear default", bent[LINEAR]),
            ("finite strain, default", bent["default"]),
        ):
            lines.append(
                f"  {name:32}tangential {m['tangential']:.3f}, normal {m['normal']:.3f}, "
                f"false shear {m['false_shear']:.4f}, resultant {1e3 * m['resultant_n']:.0f} mN"
            )
    lines += ["", "stated uncertainty of the default; material off by 1 to 2 %, white noise and half of it correlated"]
    lines += [coverage.table(result["coverage"]), "", window.table(result["window"])]
    lines += ["", resolution.table(result["resolution"])]
    if "fitted" in result:
        lines += ["", fitted.table(result["fitted"])]
    return "\n".join(lines)
