"""E, Poisson's ratio and thickness from wrench and displacement of held touches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress, material_of, stiffness_sigma_of
from ruffini.calibrate.gates import MAX_REST_N, Gate
from ruffini.estimators.base import Estimator
from ruffini.estimators.material.command import COMMAND, MaterialOptions
from ruffini.estimators.material.fit import MIN_TOUCHES, MaterialFit, fit_material, log_from_recording, log_of_touches
from ruffini.estimators.material.judge import gates_of_material, report_of_fit
from ruffini.estimators.material.prior import has_finite_strain, is_of_finite_strain, strain_remark
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.fem.operators import Noise

Array = npt.NDArray[np.float64]

TIMES_REPORT = 2.0  # of the report's 95th percentile, which one touch in 20 exceeds, but hardly any by a factor of two
SIGMA_M, TILT_M = (5e-6, 5e-6, 20e-6), 30e-6  # of the displacement under a touch: as `cal fit --only operator` has them


def material_noise(board: Board) -> Noise:
    """What the displacement is weighted with while the material is sought."""
    return Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(board), tilt_m=TILT_M)


class MaterialEstimator(Estimator):
    """The pad's numbers, which the operator is solved with."""

    name = COMMAND.name
    command = COMMAND
    makes_numbers = True
    kinds = ()
    fits_from_prior = True

    def applies(self, board: Board) -> bool:
        return board.writes("node_forces")

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit; with a fleet's or a previous calibration's numbers a few presses are enough."""
        log, prior = job.log(lambda done: progress(0.3 * done)), job.prior()
        touches = log_of_touches(log.displacement, log.wrench, log.touch, 1 if prior.is_informed else MIN_TOUCHES)
        fit = fit_material(
            job.board, touches, material_noise(job.board), prior=prior,
            is_finite=has_finite_strain(job.board, is_asked=job.is_finite),
            progress=lambda done: progress(0.3 + 0.7 * done),
        )  # fmt: skip
        job.fit, job.material, job.stiffness_sigma = fit, fit.material, fit.stiffness_sigma
        report = report_of_fit(fit)
        remarks = _remarks(job, fit, f"the prior ({prior.source})", prior.is_finite)
        is_real = not log.is_simulated and any("rig" in facts for facts in log.facts)
        if is_real and not job.is_finite and has_finite_strain(job.board, is_asked=True):
            remarks += ("a real pad was pressed and is fitted at linear strain: give --strain finite",)
        return Outcome(
            "fitted",
            f"{fit.text()}; force of a touch left out: {1e3 * report['left_out']['force_rmse_n']:.1f} mN RMS",
            report,
            remarks=remarks,
        )

    def fit_alone(self, job: Job, options: MaterialOptions, progress: Progress) -> Outcome:
        """Fit to a recording that the previous calibration measures, without leaning on that calibration's numbers."""
        path = job.path()
        log = log_from_recording(
            job.board, job.seen_with(), path, options.reference, progress=lambda done: progress(0.3 * done)
        )
        fit = fit_material(
            job.board, log, material_noise(job.board), is_finite=has_finite_strain(job.board, is_asked=job.is_finite),
            progress=lambda done: progress(0.3 + 0.7 * done),
        )  # fmt: skip
        report = report_of_fit(fit)
        before, after = (
            1e3 * sum((v or 0.0) ** 2 for v in report[k][:3]) ** 0.5 for k in ("rmse_before_n_nm", "rmse_after_n_nm")
        )
        files: tuple[Path, ...] = ()
        if options.plot is not None:
            from ruffini.estimators.material.picture import residuals

            files = (residuals(options.plot, fit, title=f"{job.board.name}: material from {path.name}"),)
        text = f"{fit.text()}; force RMSE {before:.1f} -> {after:.1f} mN"
        return Outcome("fitted", text, report, files=files, remarks=_remarks(job, fit))

    def keep(self, job: Job) -> Outcome:
        """The previous calibration's numbers, or the board's."""
        job.material = material_of(job.previous)
        if job.material is None:
            return Outcome("board", "board.toml's numbers")
        job.stiffness_sigma = stiffness_sigma_of(job.previous)
        fitted = job.previous is not None and is_of_finite_strain(job.previous)
        said = strain_remark(
            "the previous pad", fitted=fitted, used=has_finite_strain(job.board, is_asked=job.is_finite)
        )
        return Outcome("kept", "the previous numbers", remarks=() if said is None else (said,))

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        return gates_of_material(report, board) if "interval_95" in report and board is not None else []

    def allowed_n(self, report: dict[str, Any], force_n: float) -> float | None:
        """Twice what 19 of 20 touches are within."""
        left_out = report.get("left_out", {}).get("force_p95_n")
        return None if left_out is None else max(TIMES_REPORT * float(left_out), MAX_REST_N)


def _remarks(job: Job, fit: MaterialFit, prior: str = "", prior_is_finite: bool | None = None) -> tuple[str, ...]:
    """On the strain of the fit and of its prior, and on what the log does not bound."""
    said = [strain_remark(prior, fitted=prior_is_finite, used=fit.is_finite), *fit.at_bounds()]
    if job.is_finite and not fit.is_finite:
        said.append(f"board {job.board.name!r} has no second pass: its pad was fitted, and is solved, at linear strain")
    return tuple(remark for remark in said if remark is not None)


MATERIAL = MaterialEstimator()
