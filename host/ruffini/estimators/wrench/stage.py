"""The wrench of a board's targets or markers, as `ruffini cal fit --only wrench` fits it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MAX_WRENCH_ERROR, Gate, of_stage, part
from ruffini.calibrate.log.columns import read_column_logs
from ruffini.calibrate.log.videos import VideoColumns, read_video_log
from ruffini.calibrate.report.fewer_presses import Figures, Numbers, accuracy_of_presses
from ruffini.errors import InputError
from ruffini.estimators.base import TIMES_RMS, Estimator, Report
from ruffini.estimators.contact_model.stage import CONTACT
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.softness.model import Softness, fit_softness, gel_pa_of, grid_of
from ruffini.estimators.task import Task
from ruffini.estimators.wrench.adapt import adapt
from ruffini.estimators.wrench.command import COMMAND, WrenchOptions
from ruffini.estimators.wrench.fit import FEW, N_FOLDS, Fit, fit_wrench_map
from ruffini.estimators.wrench.log import (
    COLUMNS,
    FeatureRun,
    Features,
    check_number,
    check_tell_features,
    features_of,
    on_board,
    read_feature_runs,
)
from ruffini.estimators.wrench.marker_prior import marker_prior
from ruffini.estimators.wrench.model import AXES, frames_of, recordings_of
from ruffini.estimators.wrench.report import wrench_report, wrench_table
from ruffini.estimators.wrench.tables import map_in, tables
from ruffini.estimators.wrench.target_geometry import second_order_of
from ruffini.estimators.wrench.task import PRESSES, TASK
from ruffini.estimators.wrench.terms import Bend
from ruffini.files import write_whole


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


class _Read(NamedTuple):
    """A log's runs, what their features are, what is to be said of it, and the softness of its squeezes."""

    runs: list[FeatureRun]
    features: Features
    remarks: list[str]
    softness: Softness | None = None


def _read(job: Job, options: WrenchOptions, progress: Progress) -> _Read:
    """The log in whichever form it came.

    Raises
    ------
    InputError
        Options that do not go together, or features of another board.
    """
    board, named, videos = job.found, options.named_columns(), options.videos
    if videos is not None and named is not None:
        raise InputError(f"--videos {videos} names the columns of the CSV files: leave --columns and the options that "
                         "name columns out, or --videos")  # fmt: skip
    if videos is not None and board is None:
        raise InputError("--videos needs --board: the features of a video are those that its board computes")
    if named is not None:
        of_columns = read_column_logs(job.paths, named, is_raw=board is not None and not named.unit)
        features, runs = Features(COLUMNS, len(of_columns.names)), of_columns.runs
        if board is not None:
            features = features_of(board)
            if named.unit and (features.sort, named.unit) != ("markers", "px"):
                raise InputError(
                    f"--unit {named.unit}: board {board.name!r} makes integers of its {features.sort}: give the "
                    "numbers of FEATURES without a unit, or leave --board out"
                )
            check_number(job.paths[0], len(of_columns.names), board)
            runs = [on_board(run, board) for run in runs]
        return _Read(runs, features, [*of_columns.remarks])
    if board is None:
        raise InputError(f"{job.paths[0]}: name its columns (--columns FILE, or --time, --features, --wrench), or "
                         "--board for a recording of one of its sensors")  # fmt: skip
    if videos is None:
        return _Read(read_feature_runs(job.paths, board, progress=progress), features_of(board), [])
    check_tell_features(videos, board)
    of_videos = VideoColumns.read(videos)
    log = read_video_log(job.paths, board, of_videos, progress=progress)
    of_videos.check_names(run.recording for run in log.runs)
    softness = None
    if of_videos.squeeze_n is not None:
        softness = fit_softness(log.runs, grid_of(board), of_videos.rigid, of_videos.squeeze_n, gel_pa_of(board),
                                of_videos.modulus_pa)  # fmt: skip
    return _Read(log.runs, features_of(board), [*log.remarks], softness)


class WrenchEstimator(Estimator):
    """The wrench as a map of features."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("wrench", "softness")  # of squeezes in the same videos
    is_reported = True
    needed = ("wrench",)
    fits_from_calibration = True
    task = TASK

    def is_used(self, board: Board) -> bool:
        """True if a stage makes its wrench of features."""
        return "feature_wrench" in board.pipeline.stages

    def applies(self, board: Board) -> bool:
        return self.is_used(board) and not CONTACT.applies(board)  # a contact model's is fitted together with it

    def task_of(self, board: Board) -> Task:
        return PRESSES if features_of(board).is_of_gel else TASK

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit to features and reference of every log; errors on recordings, or touches, that were left out."""
        runs = read_feature_runs(job.paths, job.board, progress=progress)
        holdout = "recording" if len(set(recordings_of(runs))) >= N_FOLDS else "touch"
        mechanics: Mechanics = {"bend": second_order_of(job.board), "prior": marker_prior(job.board)}
        features = features_of(job.board)
        if job.other_units is not None:
            fit = adapt(runs, map_in(job.other_units))
        else:
            # The change of a picture is not in proportion to the normal force: slopes either side of a dent cancel.
            fit = fit_wrench_map(runs, holdout=holdout, nonlinear=features.grid is not None, grid=features.grid,
                                 is_of_gel=features.is_of_gel, **mechanics)  # fmt: skip
        tensors, metadata = tables(fit, features)
        job.tensors |= tensors
        job.metadata |= metadata
        errors = ", ".join(
            f"{axis} {error:.3g}" for axis, error, full in zip(AXES, fit.rmse, fit.map.full, strict=True) if full
        )
        said = (
            f"RMSE on {fit.left_out} left out, N and N mm: {errors}; {fit.n_frames} frames of {fit.n_runs} recordings"
        )
        fewer = [] if job.other_units is not None else _of_fewer(runs, holdout, fit, mechanics)
        return Outcome("fitted", said, {**fit.report(), "accuracy_of_presses": fewer}, remarks=tuple(fit.checks))

    def fit_alone(self, job: Job, options: WrenchOptions, progress: Progress) -> Outcome:
        """Fit to named columns, to videos beside a load cell, or to features and reference as `fit` does."""
        board = job.found
        read = _read(job, options, lambda done: progress(0.5 * done))
        if job.other_units is not None:
            fit = adapt(read.runs, map_in(job.other_units))
        else:
            fit = fit_wrench_map(
                read.runs,
                holdout=options.holdout or ("recording" if len(set(recordings_of(read.runs))) > 1 else "block"),
                bend=second_order_of(board) if board else None,
                prior=marker_prior(board) if board and options.mechanics else None,
                nonlinear=options.nonlinear,
                grid=read.features.grid,
                is_of_gel=read.features.is_of_gel,
            )
        tensors, metadata = tables(fit, read.features)
        job.tensors |= tensors
        job.metadata |= metadata
        report = {**fit.report(), "left_out": json.loads(metadata["residuals"])["left_out"]}
        details = [wrench_table(fit)]
        if read.softness is not None:
            job.tensors |= read.softness.tables()
            report["softness"] = read.softness.report()
            details.append(read.softness.text())
        details += [f"  left out: {line}" for line in report["left_out"]]
        files: tuple[Path, ...] = ()
        if options.report is not None:
            gates = [gate._asdict() for gate in of_stage(self.name, self.gates(report, board))]
            said = {"file": str(options.out), **report, "gates": gates}
            write_whole(options.report, json.dumps(said, indent=1).encode())
            files = (options.report,)
        text = (
            f"{fit.n_frames} frames of {fit.n_runs} recordings, reference {1e3 * fit.lag_s:.1f} ms behind the "
            f"pictures, condition number {fit.condition:.1f}"
        )
        return Outcome("fitted", text, report, "\n".join(details), (*read.remarks, *fit.checks), files)

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        axes = [(name, axis) for name, axis in report.get("axes", {}).items() if axis["full_scale"]]
        what = "of the largest force: RMS error on what was left out"
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
        return wrench_report(board, file, paths, previous)


WRENCH = WrenchEstimator()
