"""E, Poisson's ratio and thickness of a pad from a log of touches with a reference wrench.

A robust least-squares fit moves (E, nu, h) until the estimator's wrench (material_model.py) meets the reference. In
the wrench the three trade off against each other. What tells them apart is the shape of the displacement around the
contact: the misfit (u - C F)^T R^-1 (u - C F) of the second pass, which depends on nu and h and not on E, is fitted
with it. Where the log still leaves something open, what was believed before decides (prior.py): the board's numbers,
the previous calibration's or a fleet's; with the last two a handful of presses is enough. What the images get wrong by
a constant factor is fitted with it, so these are the numbers with which this sensor measures best, and near the
material's own where the images are right.

Confidence intervals come from leaving out one touch at a time (jackknife): frames of one touch are not independent.
With fewer than MIN_TOUCHES they are those of the fit's curvature. E, nu and h err together, so the force that they make
is known better than each: its relative standard deviation, `stiffness_sigma`, comes from the same jackknife. What a
reference of fewer than six axes does not measure is NaN and left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.log.reference import play, read_fit
from ruffini.errors import InputError
from ruffini.estimators.material.model import MaterialLog, Predictor, Shape
from ruffini.estimators.material.prior import Prior, board_prior, read_strain, strain_name, strain_remark
from ruffini.estimators.operator.fit import Material, board_slab
from ruffini.fem.operators import Noise
from ruffini.fem.slab import HIGHEST_POISSON

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[float], None]

NAMES = Material._fields
LEVER_M = 4e-3  # moments count as forces at this lever
SCALE = np.array([1.0, 1.0, 1.0, *3 * [1 / LEVER_M]])
TOUCHED_N = 0.05  # reference force above which a frame is used
MAX_FRAMES_A_TOUCH = 8
MIN_TOUCHES = 5
MOST_NAMED = 8  # touches in a message
LEAST_VARIATION = 0.05  # standard deviation of the touches' forces, of their mean
FARTHEST = 100.0  # factor from the board's E and thickness: beyond it a material file is not of this pad
DEVIATION = 0.02  # of the estimator's wrench from the reference, part of the log's spread
LARGEST_UNEXPLAINED = 0.3  # part of the reference wrench (L2)
DERIVATIVE_STEP = 1e-4  # of the board's numbers
AT_BOUND = 1e-4  # relative: nearer to a bound, a number stopped there
LARGEST_INTERVAL = 0.5  # of the value: beyond this the log does not tell the number


@dataclass(frozen=True)
class MaterialFit:
    """Values in the order of NAMES, half widths of their 95 % intervals, and the wrenches behind them.

    `stiffness_sigma` is the relative standard deviation of the force that these numbers make of a displacement.
    `is_finite`: fitted at finite strain.
    `before` and `after` are the wrenches with the board's numbers and with the fitted ones, (t, 6) N and N m;
    `left_out` those of each touch by a fit to the other touches.
    """

    values: Array
    interval: Array
    reference: Array
    touch: npt.NDArray[np.int64]
    before: Array
    after: Array
    left_out: Array
    n_touches: int
    prior: Prior
    stiffness_sigma: float
    is_finite: bool
    bounds: Array  # (2, 3): lowest and highest values that the fit tries

    def at_bounds(self) -> list[str]:
        """A sentence for each number that stopped at the end of what is tried."""
        return [
            f"{name} stopped at {value:.4g}, the {end} value that is tried on this board: compare its [pad] and the log"
            for end, limits in (("lowest", self.bounds[0]), ("highest", self.bounds[1]))
            for name, value, limit in zip(NAMES, self.values, limits, strict=True)
            if abs(value / limit - 1) < AT_BOUND
        ]

    @property
    def material(self) -> Material:
        return Material(*(float(v) for v in self.values))

    def text(self) -> str:
        """The three numbers with their 95 % intervals."""
        (e, nu, h), (e_i, nu_i, h_i) = self.values, self.interval
        return (
            f"E {e / 1e3:.1f} +- {e_i / 1e3:.1f} kPa, Poisson's ratio {nu:.4f} +- {nu_i:.4f}, thickness "
            f"{1e3 * h:.3f} +- {1e3 * h_i:.3f} mm (95 %, {self.n_touches} touches, prior: {self.prior.source})"
        )

    def report(self) -> dict[str, Any]:
        """What `ruffini cal fit --only material` prints and writes; None for what the reference does not measure."""

        def rmse(wrench: Array) -> list[float | None]:
            squared = ((wrench - self.reference) ** 2).mean(axis=0)
            return [None if np.isnan(v) else float(np.sqrt(v)) for v in squared]

        return {
            **self.material._asdict(), "strain": strain_name(self.is_finite),
            "interval_95": dict(zip(NAMES, self.interval.tolist(), strict=True)),
            "stiffness_sigma": self.stiffness_sigma,
            "touches": self.n_touches, "frames": len(self.reference), "prior": self.prior.report(),
            "rmse_before_n_nm": rmse(self.before), "rmse_after_n_nm": rmse(self.after),
            "rmse_left_out_n_nm": rmse(self.left_out),
        }  # fmt: skip


def log_from_frames(displacement: Array, wrench: Array, *, at_least: int = MIN_TOUCHES) -> MaterialLog:
    """The frames that count of a recording, in which untouched frames lie between the touches; as `log_of_touches`."""
    if len(displacement) != len(wrench) or wrench.shape[1:] != (6,):
        raise InputError(f"the log has {len(displacement)} frames and a reference of shape {wrench.shape}: (frames, 6)")
    touched = force_size(wrench) > TOUCHED_N
    return log_of_touches(displacement, wrench, np.cumsum(np.diff(touched.astype(int), prepend=0) == 1) - 1, at_least)


def force_size(wrench: Array) -> Array:
    """(t,) N of what a reference measures of the force."""
    return np.asarray(np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1))


def log_of_touches(
    displacement: Array, wrench: Array, touch: npt.NDArray[np.int64], at_least: int = MIN_TOUCHES,
    *, at_most_frames: int = MAX_FRAMES_A_TOUCH,
) -> MaterialLog:  # fmt: skip
    """Choose the frames that count: touched ones, of each touch at most so many, evenly.

    Parameters
    ----------
    displacement : (t, m, 3) float64, metres
    wrench : (t, 6) float64, N and N m about the undeformed pad centre, force on the pad; a column of NaN = not measured
    touch : (t,) number of the touch that a frame belongs to
    at_least : touches that are needed; fewer than MIN_TOUCHES are enough where pads were measured before

    Raises
    ------
    InputError
        NaN in some frames, too few touches, or always the same load.
    """
    measured = np.asarray(np.isfinite(wrench).any(axis=0))
    is_bad = ~np.isfinite(wrench[:, measured]).all(axis=1) | ~np.isfinite(displacement).all(axis=(1, 2))
    if is_bad.any():
        numbers = ", ".join(str(i) for i in np.unique(touch[is_bad])[:MOST_NAMED])
        raise InputError(f"{is_bad.sum()} frames of touch {numbers} hold NaN or infinity: cut these frames out")
    if not measured[2]:
        raise InputError("the reference has no force along z: without it nothing tells how stiff the pad is")
    size = force_size(wrench)
    chosen: list[int] = []
    touches = [np.flatnonzero((size > TOUCHED_N) & (touch == i)) for i in np.unique(touch)]
    touches = [frames for frames in touches if len(frames)]
    for frames in touches:
        chosen += frames[np.unique(np.linspace(0, len(frames) - 1, at_most_frames).astype(int))].tolist()
    if len(touches) < at_least:
        raise InputError(
            f"the log holds {len(touches)} touches above {TOUCHED_N} N: at least {at_least} are needed, "
            "with different places, depths and shear"
        )
    load = size[chosen]
    if len(touches) >= MIN_TOUCHES and load.std() < LEAST_VARIATION * load.mean():
        raise InputError(
            f"the reference reads {load.mean():.3g} N within {100 * load.std() / load.mean():.1f} % in every touch: "
            "a log without load variation determines no material; press with different forces"
        )
    return MaterialLog(displacement[chosen], wrench[chosen], touch[chosen])


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
    material = read_fit(
        path, board, "cal fit --only material", lambda tree: Material(*(float(tree[name]) for name in NAMES))
    )
    slab = board_slab(board)
    for name, value, usual in zip(NAMES, material, (slab.modulus_pa, HIGHEST_POISSON, slab.thickness_m), strict=True):
        lowest, highest = (0.0, usual) if name == "poisson" else (usual / FARTHEST, usual * FARTHEST)
        if not lowest <= value <= highest:
            raise InputError(f"{path}: {name} {value:g} is no pad of board {board.name!r}: {lowest:g} to {highest:g}")
    return material


def other_strain(path: Path, board: Board, *, is_finite: bool) -> str | None:
    """What to say of a file of `read_material` that was fitted at another strain than it is used at.

    Raises
    ------
    InputError
        Unreadable, not of this kind, or of another board.
    """
    fitted = read_fit(path, board, "cal fit --only material", read_strain)
    return strain_remark(str(path), fitted=fitted, used=is_finite)


def read_stiffness_sigma(path: Path, board: Board) -> float:
    """Relative standard deviation of the force that a fit of `read_material` leaves; of old files, that of E alone.

    Raises
    ------
    InputError
        Unreadable, not of this kind, or of another board.
    """

    def parse(tree: dict[str, Any]) -> float:
        of_modulus = float(tree["interval_95"]["modulus_pa"]) / 1.96 / float(tree["modulus_pa"])
        return float(tree.get("stiffness_sigma", of_modulus))

    sigma = read_fit(path, board, "cal fit --only material", parse)
    if not 0 <= sigma < np.inf:
        raise InputError(f"{path}: stiffness_sigma {sigma:g} is no standard deviation: fit the material again")
    return sigma


class MaterialProblem:
    """A log, what each pad would make of it, and what was believed before."""

    def __init__(self, board: Board, log: MaterialLog, predictor: Predictor, prior: Prior | None = None) -> None:
        self.log, self.predictor = log, predictor
        self.prior = prior or board_prior(board)
        self._seen = log.seen
        first, last = [predictor.poisson[0], predictor.thickness[0]], [predictor.poisson[2], predictor.thickness[2]]
        self._lower = np.array([0.2 * predictor.nominal[0], *first]) / predictor.nominal
        self._upper = np.array([5.0 * predictor.nominal[0], *last]) / predictor.nominal

    def _solved(self, used: Mask) -> OptimizeResult:
        log, nominal, seen = self.log, self.predictor.nominal, self._seen
        wrench = log.wrench[used][:, seen] * SCALE[seen]
        # The numbers of the frames of one touch err together: a touch counts once.
        n_a_touch = seen.sum() * used.sum() / len(np.unique(log.touch[used]))
        deviation = DEVIATION * max(float(np.std(wrench)), 1e-9) * np.sqrt(n_a_touch)
        shape = Shape(self.predictor, used)

        def residual(relative: Array) -> Array:
            values = relative * nominal
            difference = self.predictor.wrench(values)[used][:, seen] * SCALE[seen] - wrench
            return np.concatenate([difference.ravel() / deviation, self.prior.deviation(values),
                                   [shape.deviation(values)]])  # fmt: skip

        start = np.clip(self.prior.mean / nominal, self._lower * 1.001, self._upper * 0.999)
        return least_squares(residual, start, bounds=(self._lower, self._upper), loss="soft_l1")

    def solve(self, used: Mask) -> Array:
        """(E, nu, h) of some of the frames."""
        return np.asarray(self._solved(used).x * self.predictor.nominal)

    def curvature_covariance(self, used: Mask) -> Array:
        """Covariance (3, 3) of `solve` by the fit's curvature, relative to the board's numbers: for few touches."""
        jacobian = self._solved(used).jac
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))

    def force_ratio(self, values: Array, to: Array) -> float:
        """Forces with these numbers over those with others, over all frames."""
        force, reference = (self.predictor.wrench(v)[:, :3] for v in (values, to))
        return float((force * reference).sum() / (reference**2).sum())

    def fit(self) -> MaterialFit:
        """Fit to the whole log, and to the log without each touch.

        Raises
        ------
        InputError
            The log does not determine the numbers; the text says which and what is missing.
        """
        log, everything = self.log, np.ones(len(self.log.touch), dtype=bool)
        values = self.solve(everything)
        touches = np.unique(log.touch)
        n = len(touches)
        others = np.array([self.solve(log.touch != t) for t in touches]) if n > 1 else self.prior.mean[None]
        if n >= MIN_TOUCHES:  # times the normal 97.5 % point
            interval = 1.96 * _jackknife_sigma(others)
            stiffness_sigma = float(_jackknife_sigma(np.array([self.force_ratio(other, values) for other in others])))
        else:
            covariance, nominal = self.curvature_covariance(everything), self.predictor.nominal
            interval = 1.96 * np.sqrt(np.diag(covariance)) * nominal
            steps = np.diag(DERIVATIVE_STEP * nominal)
            slope = np.array([self.force_ratio(values + step, values) - 1 for step in steps]) / DERIVATIVE_STEP
            stiffness_sigma = float(np.sqrt(slope @ covariance @ slope))
        left_out = np.empty_like(log.wrench)
        for t, other in zip(touches, others, strict=True):
            left_out[log.touch == t] = self.predictor.wrench(other)[log.touch == t]
        before, after = self.predictor.wrench(self.predictor.nominal), self.predictor.wrench(values)
        self._check(values, interval, after)
        return MaterialFit(
            values, interval, log.wrench, log.touch, before, after, left_out, n, self.prior, stiffness_sigma,
            self.predictor.is_finite, np.stack([self._lower, self._upper]) * self.predictor.nominal,
        )  # fmt: skip

    def _check(self, values: Array, interval: Array, after: Array) -> None:
        wrench = (self.log.wrench * SCALE)[:, self._seen]
        error = ((after - self.log.wrench) * SCALE)[:, self._seen]
        unexplained = float(np.linalg.norm(error) / np.linalg.norm(wrench))
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


def _jackknife_sigma(estimates: Array) -> Array:
    """Standard error from the estimates (n, ...) that each leave one touch out."""
    n = len(estimates)
    return np.asarray(np.sqrt((n - 1) / n * ((estimates - estimates.mean(axis=0)) ** 2).sum(axis=0)))


def fit_material(
    board: Board, log: MaterialLog, noise: Noise, *, prior: Prior | None = None, is_finite: bool = False,
    progress: Progress = lambda _: None,
) -> MaterialFit:  # fmt: skip
    """Fit (E, nu, h) to a log; `prior`: the board's numbers unless given.

    is_finite: the pad is neo-Hookean and deep presses are fitted, too. E is then 2 (1 + nu) times its shear modulus.

    Raises
    ------
    InputError
        What `MaterialProblem.fit` refuses.
    """
    # Small matrices: more threads cost more than they give, far more on a busy machine.
    with threadpool_limits(limits=1):
        predictor = Predictor(board, log.displacement, noise, lambda done: progress(0.9 * done), is_finite=is_finite)
        fit = MaterialProblem(board, log, predictor, prior).fit()
    progress(1.0)
    return fit
