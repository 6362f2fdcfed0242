"""The wrench of a board's targets or markers, as `ruffini cal fit --only wrench` fits it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MAX_WRENCH_ERROR, Gate, part
from ruffini.calibrate.report.fewer_presses import Figures, Numbers, accuracy_of_presses
from ruffini.estimators.base import Estimator, Report
from ruffini.estimators.contact_model.stage import CONTACT
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.task import Task
from ruffini.estimators.wrench.fit import FEW, N_FOLDS, Fit, fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, features_of, read_feature_runs
from ruffini.estimators.wrench.marker_prior import marker_prior
from ruffini.estimators.wrench.model import AXES, frames_of, recordings_of
from ruffini.estimators.wrench.report import wrench_report_of, write_wrench_page
from ruffini.estimators.wrench.tables import tables
from ruffini.estimators.wrench.target_geometry import second_order_of
from ruffini.estimators.wrench.task import PRESSES, TASK
from ruffini.estimators.wrench.terms import Bend

TIMES_RMS = 3.0  # exceeded by three in a thousand of normally distributed errors


class Mechanics(TypedDict):
    """What a fit knows of the board beforehand (`fit_wrench_map`)."""

    bend: Bend | None
    prior: npt.NDArray[np.float64] | None


def _of_fewer(runs: list[FeatureRun], holdout: str, fit: Fit, mechanics: Mechanics) -> list[dict[str, Any]]:
    """RMS error over all axes, each over what it was loaded with; fits of many features would take hours."""
    if runs[0].features.shape[1] > FEW:
        return []
    is_told = fit.map.full > 0

    def error(used: Numbers, left: Numbers) -> Figures:
        part = fit_wrench_map([runs[i] for i in used], holdout=holdout, **mechanics)
        frames = frames_of([runs[i] for i in left], part.lag_s)
        off = (part.map.predicted(frames) - frames.wrench)[:, is_told] / fit.map.full[is_told]
        return {"error_percent": float(100 * np.sqrt(np.mean(off**2)))}

    return accuracy_of_presses(len(runs), error)


class WrenchEstimator(Estimator):
    """The wrench as a map of features."""

    name = "wrench"
    kinds = ("wrench", "softness")  # of squeezes in the same videos
    is_reported = True
    needed = ("wrench",)
    task = TASK

    def is_used(self, board: Board) -> bool:
        """True if a stage makes its wrench of features."""
        return "feature_wrench" in board.pipeline.stages

    def applies(self, board: Board) -> bool:
        return self.is_used(board) and not CONTACT.applies(board)  # a contact model's is fitted together with it

    def task_of(self, board: Board) -> Task:
        return PRESSES if features_of(board).sort == "picture" else TASK

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit to features and reference of every log; errors on recordings, or touches, that were left out."""
        runs = read_feature_runs(job.paths, job.board, progress=progress)
        holdout = "recording" if len(set(recordings_of(runs))) >= N_FOLDS else "touch"
        mechanics: Mechanics = {"bend": second_order_of(job.board), "prior": marker_prior(job.board)}
        features = features_of(job.board)
        # The change of a picture is not in proportion to the normal force: slopes on either side of a dent cancel.
        fit = fit_wrench_map(runs, holdout=holdout, nonlinear=features.grid is not None, grid=features.grid,
                             **mechanics)  # fmt: skip
        tensors, metadata = tables(fit, features)
        job.tensors |= tensors
        job.metadata |= metadata
        errors = ", ".join(
            f"{axis} {error:.3g}" for axis, error, full in zip(AXES, fit.rmse, fit.map.full, strict=True) if full
        )
        said = (
            f"RMSE on {fit.left_out} left out, N and N mm: {errors}; {fit.n_frames} frames of {fit.n_runs} recordings"
        )
        return Outcome(
            "fitted", said, {**fit.report(), "accuracy_of_presses": _of_fewer(runs, holdout, fit, mechanics)}
        )

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        axes = [(name, axis) for name, axis in report.get("axes", {}).items() if axis["full_scale"]]
        what = "of full scale: RMS left out"
        return [
            part(f"wrench {name}", axis["rmse"] / abs(axis["full_scale"]), MAX_WRENCH_ERROR, what)
            for name, axis in axes
        ]

    def allowed_n(self, report: dict[str, Any], force_n: float) -> float | None:
        """Three times the RMS error of the normal force on what was left out."""
        axis = report.get("axes", {}).get("Fz", {})
        return TIMES_RMS * float(axis["rmse"]) if axis.get("full_scale") else None

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        made = wrench_report_of(board, file, paths, previous=previous)
        told = [f"{name} {axis['rmse']:.3g}" for name, axis in made.tree["axes"].items() if axis["rmse"] is not None]
        text = f"off by {', '.join(told)} RMS (N, N mm) over {made.tree['log']['touches']} loads"
        return Report(made.tree, made.gates, text, lambda path: write_wrench_page(path, file, made))


WRENCH = WrenchEstimator()
