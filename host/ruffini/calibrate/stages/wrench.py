"""The wrench of a board's targets or markers, as `ruffini cal wrench` fits it."""

from __future__ import annotations

from ruffini.calibrate.feature_log import features_of, read_feature_runs
from ruffini.calibrate.marker_prior import marker_prior
from ruffini.calibrate.stages.job import Job, Outcome, Progress, Stage
from ruffini.calibrate.target_geometry import second_order_of
from ruffini.calibrate.wrench_map import fit_wrench_map
from ruffini.calibrate.wrench_model import AXES
from ruffini.calibrate.wrench_tables import tables
from ruffini.errors import InputError


def run(job: Job, progress: Progress) -> Outcome:
    """Fit to features and reference of every log; errors on recordings, or touches, that were left out."""
    runs = read_feature_runs(job.paths, job.board, progress=progress)
    holdout = "recording" if len(runs) > 1 else "touch"
    fit = fit_wrench_map(runs, holdout=holdout, bend=second_order_of(job.board), prior=marker_prior(job.board))
    tensors, metadata = tables(fit, features_of(job.board))
    job.tensors |= tensors
    job.metadata |= metadata
    errors = ", ".join(
        f"{axis} {error:.3g}" for axis, error, full in zip(AXES, fit.rmse, fit.map.full, strict=True) if full
    )
    said = f"RMSE on {fit.left_out} left out, N and N mm: {errors}; {fit.n_frames} frames of {fit.n_runs} recordings"
    return Outcome("fitted", said, fit.report())


def keep(job: Job) -> Outcome:
    """The previous calibration's."""
    taken = job.take("wrench")
    if taken is None:
        raise InputError("--skip wrench needs a calibration that has one: give --previous FILE")
    return taken


def is_needed(job: Job) -> bool:
    """Whether the board makes its wrench of features."""
    return "feature_wrench" in job.board.pipeline.stages


STAGE = Stage("wrench", is_needed, run, keep)
