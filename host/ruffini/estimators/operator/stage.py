"""The inverse finite elements of this unit: solved for its material and its noise, compiled to the board's integers."""

from __future__ import annotations

from pathlib import Path

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate
from ruffini.calibrate.log.touches import file_sha256, read_touch_log
from ruffini.estimators.base import Estimator, Report
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.material.stage import material_noise
from ruffini.estimators.operator.fit import make_operator, stiffer
from ruffini.estimators.operator.judge import gates_of_forces, gates_of_touches, judged
from ruffini.estimators.operator.page import write_page
from ruffini.estimators.operator.report import report_of
from ruffini.estimators.operator.task import TASK


class Operator(Estimator):
    """Forces at the nodes, from displacements."""

    name = "operator"
    kinds = ("operator", "support", "finite_strain", "gauge", "marker_depth")
    is_reported = True
    needed = ("operator",)
    takes_prior = True
    task = TASK

    def applies(self, board: Board) -> bool:
        return "operator" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Make the operator, and where the board has one the second pass with its error model."""
        known, sigma = job.material, job.stiffness_sigma
        if job.instant_gain != 1.0:
            known = stiffer(job.board, known, job.instant_gain)
        method = "support" if "support" in job.board.pipeline.stages else "optimal"
        kind = make_operator(
            job.board, method=method, noise=job.noise or material_noise(job.board), material=known,
            stiffness_sigma=sigma,
            is_finite=job.is_finite and method == "support", n_touches=job.n_error_touches, progress=progress,
        )  # fmt: skip
        job.tensors |= kind.tensors
        job.metadata |= kind.metadata
        job.matrix = kind.matrix
        text = f"{method}, rounding error {int(kind.metadata['operator.error_1e9']) * 1e-9:.1e}"
        if kind.no_errors is not None:
            text += f"; uncertainty will not be measured: {kind.no_errors}"
        return Outcome("fitted", text, {"method": method, "worst_error_un": kind.metadata["operator.worst_error_un"]})

    def start(self, job: Job) -> None:
        """The operator of the board's own numbers."""
        kind = make_operator(job.board, method="support", noise=material_noise(job.board))
        job.tensors |= kind.tensors
        job.metadata |= kind.metadata

    def gates_of_log(self, job: Job, file: CalibrationFile) -> list[Gate]:
        log, informed = job.log(), job.fit is not None and job.fit.prior.is_informed
        previous = None if job.previous is None else judged(job.board, job.previous, log)
        now = judged(job.board, file, log)
        forces = [] if now is None else gates_of_forces(job.board, log, now, previous)
        return [*gates_of_touches(job.board, log, is_informed=informed), *forces]

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        log = read_touch_log(
            paths, board, file, from_pictures=_saw_pictures(file, paths), progress=lambda done: progress(0.2 * done)
        )
        made = report_of(
            board, file, log, previous=previous, fleet=fleet, progress=lambda done: progress(0.2 + 0.8 * done)
        )
        off_mn = 1e3 * made.tree["wrench"]["force_rmse_n"]
        text = f"force off by {off_mn:.1f} mN RMS over {log.n_touches} touches"
        return Report(made.tree, made.gates, text, lambda path: write_page(path, board, file, made))


def _saw_pictures(file: CalibrationFile, paths: list[Path]) -> bool:
    """True if the fit saw these logs with colours that it had learned itself, not with those of the sensor then."""
    said = container.residuals(file)
    fitted = said.get("logs")
    if said.get("from_pictures") is not True or not isinstance(fitted, dict):
        return False
    return all(file_sha256(path) in fitted.values() for path in paths)


OPERATOR = Operator()
