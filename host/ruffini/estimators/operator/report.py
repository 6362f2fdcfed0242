"""What a log says of a calibration: `ruffini cal report`, as numbers; `page` shows them.

The calibration is run over the log's displacements on the board's own integers. Beside that, what pads fitted to parts
of the log say of the rest of it: each touch left out, and growing numbers of presses, with and without a prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import material_of
from ruffini.calibrate.gates import Gate, failed, gates_in, gates_of_reference
from ruffini.calibrate.log.touches import TouchLog
from ruffini.calibrate.log.warmth import celsius_ranges
from ruffini.calibrate.report import fewer_presses
from ruffini.calibrate.report.fewer_presses import Figures, Numbers
from ruffini.calibrate.report.page import about
from ruffini.errors import InputError
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit, MaterialProblem, log_of_touches
from ruffini.estimators.material.judge import gates_of_material, left_out_figures, report_of_fit
from ruffini.estimators.material.model import MaterialLog, Predictor, Progress
from ruffini.estimators.material.prior import Prior, board_prior, is_of_finite_strain, next_gel_prior
from ruffini.estimators.material.stage import SIGMA_M, TILT_M
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.estimators.operator.judge import (
    Judged,
    contact_places,
    coverage,
    force_rmse_n,
    gates_of_forces,
    gates_of_touches,
    judged,
)
from ruffini.fem.operators import Noise
from ruffini.rig.units import GRAVITY_M_S2

Array = npt.NDArray[np.float64]

PRESSES = (1, 2, 3, *fewer_presses.SIZES)
N_WORST = 3  # presses by hand that are named
DRAWS = 8  # of presses, for each number of them


@dataclass(frozen=True)
class ForceReport:
    """`tree` is the JSON; the arrays behind its pictures: places (n, 3) m, error of each touch (n, 6), fit."""

    tree: dict[str, Any]
    gates: list[Gate]
    places: Array
    wrench: Array  # (n, 6) of each touch by this calibration
    reference: Array  # (n, 6)
    fit: MaterialFit | None


def report_of(
    board: Board, file: CalibrationFile, log: TouchLog, *, previous: CalibrationFile | None = None,
    fleet: Prior | None = None, progress: Progress = lambda _: None,
) -> ForceReport:  # fmt: skip
    """Judge a calibration on a log, the one that it was fitted to or another.

    Raises
    ------
    InputError
        The calibration has no operator: there are no forces to judge.
    """
    now = judged(board, file, log)
    if now is None:
        raise InputError("this calibration has no operator: there are no forces to judge")
    before = None if previous is None else judged(board, previous, log)
    prior = fleet or _prior_of(previous)
    origin = _origin(file, log)
    fit: MaterialFit | None = None
    curve: list[dict[str, Any]] = []
    unfit: Gate | None = None
    try:
        with threadpool_limits(limits=1):
            fit, curve = _fitted(board, log, prior, progress, is_finite=is_of_finite_strain(file))
    except InputError as error:  # the log contradicts every pad: that is for the page, too
        unfit = Gate("pad", False, None, None, str(error))
    gates = [
        *gates_of_touches(board, log, is_informed=fit is not None and fit.prior.is_informed),
        *gates_of_reference(log.found),
        *([] if fit is None else gates_of_material(report_of_fit(fit), board)),
        *gates_of_forces(board, log, now, before),
        *([unfit] if unfit else []),
    ]
    if origin["in_the_fit"]:  # what its own stages found is not in this log any more
        gates += [g for g in gates_in(file) or [] if g.name not in {gate.name for gate in gates}]
    tree = {
        "board": board.name, "calibration": about(file), "log": origin, "passed": not failed(gates),
        "gates": [gate._asdict() for gate in gates], "wrench": _errors(log, now),
        "left_out": None if fit is None or fit.n_touches < MIN_TOUCHES else left_out_figures(fit),
        "accuracy_of_presses": curve, "coverage": coverage(board, contact_places(board, log)).tolist(),
        "valid_for": _ranges(board, log), "worst": _worst(log, now),
        "previous": None if before is None else {"force_rmse_n": force_rmse_n(log, before.wrench)},
    }  # fmt: skip
    return ForceReport(
        tree, gates, contact_places(board, log), by_touch(log, now.wrench), by_touch(log, log.wrench), fit
    )


def _prior_of(previous: CalibrationFile | None) -> Prior | None:
    material = material_of(previous)
    if material is None or previous is None:
        return None
    return next_gel_prior(material, is_finite=is_of_finite_strain(previous))


def by_touch(log: TouchLog, values: Array) -> Array:
    """Mean over the frames of each touch, (n, k)."""
    return np.array([values[log.touch == t].mean(axis=0) for t in np.unique(log.touch)])


def _fitted(
    board: Board, log: TouchLog, prior: Prior | None, progress: Progress, *, is_finite: bool
) -> tuple[MaterialFit | None, list[dict[str, Any]]]:
    """A fit of the log itself, and how good a fit of fewer presses is for the others."""
    if "support" not in board.pipeline.stages:
        return None, []
    touches = log_of_touches(log.displacement, log.wrench, log.touch, 1)
    noise = Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(board), tilt_m=TILT_M)
    predictor = Predictor(board, touches.displacement, noise, lambda done: progress(0.7 * done), is_finite=is_finite)
    problem = MaterialProblem(board, touches, predictor, prior)
    fit = problem.fit() if prior is not None or len(np.unique(touches.touch)) >= MIN_TOUCHES else None
    progress(0.8)
    curve = accuracy_of_presses(board, touches, predictor, prior, lambda done: progress(0.8 + 0.2 * done))
    return fit, curve


def accuracy_of_presses(
    board: Board, log: MaterialLog, predictor: Predictor, prior: Prior | None, progress: Progress = lambda _: None
) -> list[dict[str, Any]]:
    """For growing numbers of presses: RMS force error (N) on touches that were not among them, over several draws.

    "board": with the board's numbers as prior; "prior": with the one that is given.
    """
    touches = np.unique(log.touch)
    priors = {"board": board_prior(board), **({} if prior is None else {"prior": prior})}
    problems = {name: MaterialProblem(board, log, predictor, p) for name, p in priors.items()}
    rows: list[dict[str, Any]] = [{"presses": 0} | {
        name: float(np.sqrt(np.mean(np.square(touch_errors(log, predictor.wrench(p.mean), touches)))))
        for name, p in priors.items()
    }]  # fmt: skip

    def error(fitted: Numbers, left: Numbers) -> Figures:
        used, out = np.isin(log.touch, touches[fitted]), {}
        for name, problem in problems.items():
            wrench = predictor.wrench(problem.solve(used))
            out[name] = float(np.sqrt(np.mean(np.square(touch_errors(log, wrench, touches[left])))))
        return out

    return rows + fewer_presses.accuracy_of_presses(
        len(touches), error, progress, sizes=PRESSES, n_draws=DRAWS, is_shuffled=True
    )


def touch_errors(log: MaterialLog, wrench: Array, touches: npt.NDArray[np.int64]) -> Array:
    """Length of the mean force error of each touch, of what the reference measures, N."""
    seen = log.seen[:3]
    error = (wrench - log.wrench)[:, :3][:, seen]
    return np.array([np.linalg.norm(error[log.touch == t].mean(axis=0)) for t in touches])


def _origin(file: CalibrationFile, log: TouchLog) -> dict[str, Any]:
    fitted_to = file.metadata.get("residuals", "")
    return {
        "files": log.sources, "touches": log.n_touches, "frames": len(log.wrench), "untouched_frames": len(log.rest),
        "in_the_fit": all(sha in fitted_to for sha in log.sources.values()),
        "simulated": log.is_simulated,
    }  # fmt: skip


def _errors(log: TouchLog, now: Judged) -> dict[str, Any]:
    error = by_touch(log, now.wrench - log.wrench)
    device = by_touch(log, log.device - log.wrench)

    def rms(values: Array) -> list[float | None]:
        return [None if np.isnan(v).any() else float(np.sqrt(np.mean(v**2))) for v in values.T]

    return {
        "rmse_n_nm": rms(error), "force_rmse_n": force_rmse_n(log, now.wrench),
        "as_the_sensor_said_n_nm": rms(device),
        "largest_force_n": float(np.nanmax(np.linalg.norm(np.nan_to_num(log.wrench[:, :3]), axis=1))),
        "untouched_p99_n": float(np.percentile(np.linalg.norm(now.rest_n, axis=1), 99)) if len(now.rest_n) else None,
    }  # fmt: skip


def _worst(log: TouchLog, now: Judged) -> list[dict[str, Any]]:
    """The presses by hand whose force is furthest off, first the worst: what to press again."""
    facts = log.touch_facts
    if len(facts) != log.n_touches:  # a touch without a frame that counts
        return []
    error_n = np.linalg.norm(np.nan_to_num(by_touch(log, now.wrench - log.wrench)[:, :3]), axis=1)
    rows = [{"told": facts[i]["told"], "x_m": facts[i]["x_m"], "y_m": facts[i]["y_m"], "grams": grams,
             "error_n": float(error_n[i])} for i in np.argsort(-error_n) if (grams := _grams(facts[i]))]  # fmt: skip
    return rows[:N_WORST]


def _grams(facts: dict[str, Any]) -> float | None:
    """That a press by hand was asked for; None of a bench's touch."""
    if facts.get("kind") == "hand":  # by a reference that is read without a person
        return round(1e3 * float(facts["force_n"]) / GRAVITY_M_S2, 6)  # so that grams that became newtons are the same
    return facts.get("grams")


def _ranges(board: Board, log: TouchLog) -> dict[str, Any]:
    """What the log tried: outside of it nothing is known."""
    places, wrench = contact_places(board, log), np.nan_to_num(by_touch(log, log.wrench))
    return {
        "depth_mm": [float(1e3 * v) for v in (places[:, 2].min(), places[:, 2].max())],
        "normal_force_n": [float(v) for v in (-wrench[:, 2].max(), -wrench[:, 2].min())],
        "shear_force_n": [0.0, float(np.hypot(wrench[:, 0], wrench[:, 1]).max())],
        "x_mm": [float(1e3 * v) for v in (places[:, 0].min(), places[:, 0].max())],
        "y_mm": [float(1e3 * v) for v in (places[:, 1].min(), places[:, 1].max())],
        "temperature_c": celsius_ranges(log.touch_facts),
    }  # fmt: skip
