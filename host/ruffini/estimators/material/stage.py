"""E, Poisson's ratio and thickness from wrench and displacement of held touches."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress, material_of, stiffness_sigma_of
from ruffini.calibrate.gates import MAX_REST_N, Gate
from ruffini.estimators.base import Estimator
from ruffini.estimators.material.fit import MIN_TOUCHES, fit_material, log_of_touches
from ruffini.estimators.material.judge import gates_of_material, left_out_figures
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

    name = "material"
    kinds = ()
    fits_from_prior = True

    def applies(self, board: Board) -> bool:
        return board.writes("node_forces")

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit; with a fleet's or a previous calibration's numbers a few presses are enough."""
        log, prior = job.log(lambda done: progress(0.3 * done)), job.prior()
        touches = log_of_touches(log.displacement, log.wrench, log.touch, 1 if prior.is_informed else MIN_TOUCHES)
        fit = fit_material(
            job.board, touches, material_noise(job.board), prior=prior, progress=lambda done: progress(0.3 + 0.7 * done)
        )
        job.fit, job.material, job.stiffness_sigma = fit, fit.material, fit.stiffness_sigma
        report = {**fit.report(), "left_out": left_out_figures(fit)}
        return Outcome(
            "fitted",
            f"{fit.text()}; force of a touch left out: {1e3 * report['left_out']['force_rmse_n']:.1f} mN RMS",
            report,
        )

    def keep(self, job: Job) -> Outcome:
        """The previous calibration's numbers, or the board's."""
        job.material = material_of(job.previous)
        if job.material is None:
            return Outcome("board", "board.toml's numbers")
        job.stiffness_sigma = stiffness_sigma_of(job.previous)
        return Outcome("kept", "the previous numbers")

    def gates_of_log(self, job: Job, file: CalibrationFile) -> list[Gate]:
        return [] if job.fit is None else gates_of_material(job.fit, job.board)

    def allowed_n(self, report: dict[str, Any], force_n: float) -> float | None:
        """Twice what 19 of 20 touches are within."""
        left_out = report.get("left_out", {}).get("force_p95_n")
        return None if left_out is None else max(TIMES_REPORT * float(left_out), MAX_REST_N)


MATERIAL = MaterialEstimator()
