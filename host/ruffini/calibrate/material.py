"""E, Poisson's ratio and thickness of a pad from a log of touches with a reference wrench.

The estimator's wrench W(u; E, nu, h) is linear in E and smooth in (nu, h). It is computed with the board's own
second pass on a 3 x 3 grid of (nu, h) around the board's numbers and interpolated there; a robust least-squares fit
moves (E, nu, h) until it meets the reference. In the wrench the three trade off against each other. What tells them
apart is the shape of the displacement around the contact: the misfit (u - C F)^T R^-1 (u - C F) of the second pass,
which depends on nu and h and not on E, is fitted with it. Where the log still leaves something open, the board's
numbers decide (PRIOR). What the images get wrong by a constant factor is fitted with it, so these are the numbers with
which this sensor measures best, and near the material's own where the images are right.

Confidence intervals come from leaving out one touch at a time (jackknife): frames of one touch are not independent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.operator import Material, board_slab, board_window_m, observed_unknowns
from ruffini.calibrate.reference_log import play, read_fit
from ruffini.errors import InputError
from ruffini.fem.condense import condense
from ruffini.fem.operators import Noise, force_operator
from ruffini.fem.slab import HIGHEST_POISSON, Slab
from ruffini.fem.support import SupportSystem, contact_mask, solve_on_support, support_system

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

NAMES = Material._fields
THICKNESS_FACTORS = (0.9, 1.0, 1.1)
POISSON_FACTORS = (0.94, 1.0, 1.035)
HIGHEST_FITTED_POISSON = 0.4985
LEVER_M = 4e-3  # moments count as forces at this lever
TOUCHED_N = 0.05  # reference force above which a frame is used
MAX_FRAMES_A_TOUCH = 8
MIN_TOUCHES = 5
LEAST_VARIATION = 0.05  # standard deviation of the touches' forces, of their mean
FARTHEST = 100.0  # factor from the board's E and thickness: beyond it a material file is not of this pad
# Of the board's numbers (E, nu, h): what a datasheet and a caliper know. It decides only where the log does not.
PRIOR = (0.3, 0.03, 0.05)
DEVIATION = 0.02  # of the estimator's wrench from the reference, part of the log's spread
SHAPE_DEVIATION = 0.01  # of the displacement from any pad's, part of what touches explain of it (L2)
SHAPE_LINES = 41  # along nu and h, on which the least misfit is looked for
LARGEST_UNEXPLAINED = 0.3  # part of the reference wrench (L2)
LARGEST_INTERVAL = 0.5  # of the value: beyond this the log does not tell the number


@dataclass(frozen=True)
class MaterialLog:
    """Displacement (t, m, 3) m at the observed nodes, reference wrench (t, 6) N and N m, number of the touch (t,)."""

    displacement: Array
    wrench: Array
    touch: npt.NDArray[np.int64]


@dataclass(frozen=True)
class MaterialFit:
    """Values in the order of NAMES, half widths of their 95 % intervals, and the wrenches behind them.

    `before` and `after` are the wrenches with the board's numbers and with the fitted ones, (t, 6) N and N m.
    """

    values: Array
    interval: Array
    reference: Array
    before: Array
    after: Array
    n_touches: int

    @property
    def material(self) -> Material:
        return Material(*(float(v) for v in self.values))

    def report(self) -> dict[str, Any]:
        """What `ruffini cal material` prints and writes."""

        def rmse(wrench: Array) -> list[float]:
            return [float(v) for v in np.sqrt(((wrench - self.reference) ** 2).mean(axis=0))]

        return {
            **self.material._asdict(),
            "interval_95": dict(zip(NAMES, self.interval.tolist(), strict=True)),
            "touches": self.n_touches, "frames": len(self.reference),
            "rmse_before_n_nm": rmse(self.before), "rmse_after_n_nm": rmse(self.after),
        }  # fmt: skip


def log_from_frames(displacement: Array, wrench: Array) -> MaterialLog:
    """Choose the frames that count: touched ones, at most MAX_FRAMES_A_TOUCH of each touch, strongest last.

    Parameters
    ----------
    displacement : (t, m, 3) float64, metres
    wrench : (t, 6) float64, N and N m about the undeformed pad centre, force on the pad

    Raises
    ------
    InputError
        NaN, other lengths, fewer than MIN_TOUCHES touches, or always the same load.
    """
    if len(displacement) != len(wrench) or wrench.shape[1:] != (6,):
        raise InputError(f"the log has {len(displacement)} frames and a reference of shape {wrench.shape}: (frames, 6)")
    if not np.isfinite(wrench).all() or not np.isfinite(displacement).all():
        raise InputError("the log holds NaN or infinity: cut these frames out")
    touched = np.linalg.norm(wrench[:, :3], axis=1) > TOUCHED_N
    number = np.cumsum(np.diff(touched.astype(int), prepend=0) == 1) - 1
    chosen: list[int] = []
    touches = [np.flatnonzero(touched & (number == i)) for i in range(int(number.max(initial=-1)) + 1)]
    for frames in touches:
        chosen += frames[np.unique(np.linspace(0, len(frames) - 1, MAX_FRAMES_A_TOUCH).astype(int))].tolist()
    if len(touches) < MIN_TOUCHES:
        raise InputError(
            f"the log holds {len(touches)} touches above {TOUCHED_N} N: at least {MIN_TOUCHES} are needed, "
            "with different places, depths and shear"
        )
    load = np.linalg.norm(wrench[chosen, :3], axis=1)
    if load.std() < LEAST_VARIATION * load.mean():
        raise InputError(
            f"the reference reads {load.mean():.3g} N within {100 * load.std() / load.mean():.1f} % in every touch: "
            "a log without load variation determines no material; press with different forces"
        )
    return MaterialLog(displacement[chosen], wrench[chosen], number[chosen])


def log_from_recording(
    board: Board, calibration: CalibrationFile, recording: Path, reference: Path | None, *, progress: Progress
) -> MaterialLog:
    """The board's displacement beside the reference wrench, of the frames that count.

    Raises
    ------
    InputError
        What `reference_log.play` and `log_from_frames` refuse.
    """
    played = play(
        board, calibration, recording, reference, lambda pipeline, _: pipeline.displacement_m().reshape(-1, 3),
        progress=progress,
    )  # fmt: skip
    return log_from_frames(played.taken, played.wrench)


def read_material(path: Path, board: Board) -> Material:
    """What `reference_log.write_fit` wrote of a fit.

    Raises
    ------
    InputError
        Unreadable, not of this kind, or of another board.
    """
    material = read_fit(path, board, "cal material", lambda tree: Material(*(float(tree[name]) for name in NAMES)))
    slab = board_slab(board)
    for name, value, usual in zip(NAMES, material, (slab.modulus_pa, HIGHEST_POISSON, slab.thickness_m), strict=True):
        lowest, highest = (0.0, usual) if name == "poisson" else (usual / FARTHEST, usual * FARTHEST)
        if not lowest <= value <= highest:
            raise InputError(f"{path}: {name} {value:g} is no pad of board {board.name!r}: {lowest:g} to {highest:g}")
    return material


class _Predictor:
    """Wrench of every frame of a log for any (E, nu, h) within the grid."""

    def __init__(self, board: Board, log: MaterialLog, noise: Noise, progress: Progress) -> None:
        slab = board_slab(board)
        observed = observed_unknowns(board)
        self.nominal = np.array([slab.modulus_pa, slab.poisson, slab.thickness_m])
        self.poisson = _poisson_grid(slab.poisson)
        self.thickness = slab.thickness_m * np.array(THICKNESS_FACTORS)
        u = log.displacement.reshape(len(log.displacement), -1)
        threshold_n = board.contact.threshold_un * 1e-6
        rows, columns = board.observed
        shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
        operator = force_operator(slab, "optimal", noise=noise, window_m=board_window_m(board))
        linear = u @ operator.T
        masks = [
            contact_mask(f.reshape(shape)[..., 2], threshold_n=threshold_n, min_nodes=board.contact.min_nodes).ravel()
            for f in linear
        ]
        arms = _arms(board, slab)
        self.at_grid = np.empty((3, 3, len(u), 6))
        self.misfit = np.empty((3, 3, len(u)))
        for i, poisson in enumerate(self.poisson):
            for j, thickness in enumerate(self.thickness):
                system = support_system(
                    condense(replace(slab, poisson=poisson, thickness_m=thickness)), noise, observed, operator
                )
                self.at_grid[i, j], self.misfit[i, j] = _wrenches(system, u, linear, masks, arms, threshold_n)
                progress((3 * i + j + 1) / 9)

    def wrench(self, values: Array) -> Array:
        """(t, 6); quadratic in nu and h, linear in E."""
        along_nu = _lagrange(self.poisson, values[1])
        along_h = _lagrange(self.thickness, values[2])
        per_modulus = np.einsum("i,j,ijtc->tc", along_nu, along_h, self.at_grid) / self.nominal[0]
        return np.asarray(per_modulus * values[0])


class _Shape:
    """How much worse (nu, h) explain the displacement of some frames than the best pad does, in standard deviations."""

    def __init__(self, predictor: _Predictor, used: npt.NDArray[np.bool_]) -> None:
        self._poisson, self._thickness = predictor.poisson, predictor.thickness
        self._misfit = predictor.misfit[:, :, used].mean(axis=2)
        lines = [np.linspace(axis[0], axis[2], SHAPE_LINES) for axis in (self._poisson, self._thickness)]
        self._least = min(self._at(nu, h) for nu in lines[0] for h in lines[1])

    def _at(self, poisson: float, thickness: float) -> float:
        return float(_lagrange(self._poisson, poisson) @ self._misfit @ _lagrange(self._thickness, thickness))

    def deviation(self, values: Array) -> float:
        explained = max(-self._least, 1e-9)  # of u^T R^-1 u, which is the same for all pads
        return float(np.sqrt(max(self._at(values[1], values[2]) - self._least, 0.0) / explained) / SHAPE_DEVIATION)


def _poisson_grid(poisson: float) -> Array:
    """Three ratios about the board's, all of them below HIGHEST_FITTED_POISSON and apart."""
    middle = min(poisson, HIGHEST_FITTED_POISSON / POISSON_FACTORS[2] ** 0.5)
    grid = np.minimum(middle * np.array(POISSON_FACTORS), HIGHEST_FITTED_POISSON)
    if grid[2] - grid[0] < 1e-3:
        raise InputError(f"Poisson's ratio {poisson:g} of the board cannot be fitted: write what a datasheet says")
    return np.asarray(grid)


def _arms(board: Board, slab: Slab) -> Array:
    """Places of the observed nodes from the pad's centre, (m, 3) m."""
    rows, columns = board.observed
    x = (np.arange(slab.n_x) - (slab.n_x - 1) / 2)[columns] * slab.step_m[0]
    y = (np.arange(slab.n_y) - (slab.n_y - 1) / 2)[rows] * slab.step_m[1]
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def _wrenches(
    system: SupportSystem, u: Array, linear: Array, masks: list[Array], arms: Array, threshold_n: float
) -> tuple[Array, Array]:
    """Wrench of each frame, and (u - C F)^T R^-1 (u - C F) less u^T R^-1 u."""
    wrench, misfit = np.empty((len(u), 6)), np.empty(len(u))
    for k, (u_k, start, mask) in enumerate(zip(u, linear, masks, strict=True)):
        force = solve_on_support(system, u_k, start, mask, threshold_n=threshold_n)
        index = np.flatnonzero(force)
        y = force[index] / system.scale_n[index]
        misfit[k] = y @ (system.normal[np.ix_(index, index)] @ y - 2 * (system.project[index] @ u_k))
        nodal = force.reshape(-1, 3)
        wrench[k] = np.concatenate([nodal.sum(axis=0), np.cross(arms, nodal).sum(axis=0)])
    return wrench, misfit


def _lagrange(nodes: Array, at: float) -> Array:
    """Weights of the quadratic through three nodes."""
    return np.array([np.prod([(at - nodes[j]) / (nodes[i] - nodes[j]) for j in range(3) if j != i]) for i in range(3)])


def fit_material(board: Board, log: MaterialLog, noise: Noise, *, progress: Progress = lambda _: None) -> MaterialFit:
    """Fit (E, nu, h) to a log.

    Raises
    ------
    InputError
        The log does not determine the numbers; the text says which and what is missing.
    """
    with threadpool_limits(
        limits=1
    ):  # small matrices: more threads cost more than they give, far more on a busy machine
        predictor = _Predictor(board, log, noise, lambda done: progress(0.9 * done))
    scale = np.array([1.0, 1.0, 1.0, *3 * [1 / LEVER_M]])
    lower = np.array([0.2 * predictor.nominal[0], predictor.poisson[0], predictor.thickness[0]])
    upper = np.array([5.0 * predictor.nominal[0], predictor.poisson[2], predictor.thickness[2]])

    def solve(used: npt.NDArray[np.bool_]) -> Array:
        spread = max(float(np.std(log.wrench[used] * scale)), 1e-9)
        # The six numbers of the frames of one touch err together: a touch counts once.
        deviation = DEVIATION * spread * np.sqrt(6 * used.sum() / len(np.unique(log.touch[used])))

        shape = _Shape(predictor, used)

        def residual(relative: Array) -> Array:
            values = relative * predictor.nominal
            difference = (predictor.wrench(values) - log.wrench)[used] * scale
            return np.concatenate([difference.ravel() / deviation, (relative - 1) / PRIOR, [shape.deviation(values)]])

        start = np.clip(np.ones(3), lower / predictor.nominal * 1.001, upper / predictor.nominal * 0.999)
        found = least_squares(
            residual, start, bounds=(lower / predictor.nominal, upper / predictor.nominal), loss="soft_l1"
        )
        return np.asarray(found.x * predictor.nominal)

    values = solve(np.ones(len(log.touch), dtype=bool))
    touches = np.unique(log.touch)
    left_out = np.array([solve(log.touch != t) for t in touches])
    n = len(touches)
    # Jackknife standard error, times the normal 97.5 % point.
    interval = 1.96 * np.sqrt((n - 1) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    progress(1.0)
    after = predictor.wrench(values)
    unexplained = float(np.linalg.norm((after - log.wrench) * scale) / np.linalg.norm(log.wrench * scale))
    if unexplained > LARGEST_UNEXPLAINED:
        raise InputError(
            f"the log does not fit any pad: {100 * unexplained:.0f} % of the reference wrench stays unexplained; "
            "are its frames and rows in step, its axes and units those of the documentation?"
        )
    vague = [name for name, v, i in zip(NAMES, values, interval, strict=True) if i > LARGEST_INTERVAL * v]
    if vague:
        raise InputError(
            f"the log does not determine {', '.join(vague)} (95 % interval above half the value): "
            "add presses of several sizes and depths, with and without shear"
        )
    return MaterialFit(values, interval, log.wrench, predictor.wrench(predictor.nominal), after, n)
