"""Force, way, place, angles and area of a tool on a fingertip, from the pins that its two eyes see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MIN_PRESSES, Gate, at_least, at_most, failed, gates_in, part
from ruffini.errors import InputError
from ruffini.estimators.base import TIMES_RMS, Estimator, Report
from ruffini.estimators.fingertip.command import COMMAND
from ruffini.estimators.fingertip.fit import fit_fingertip
from ruffini.estimators.fingertip.log import press_roots
from ruffini.estimators.fingertip.report import full_n, tip_report_of, write_tip_page
from ruffini.estimators.fingertip.tables import tables
from ruffini.estimators.fingertip.task import TASK
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.task import Turned

MAX_FORCE, MAX_WAY_MM, MAX_TILT_DEG = 0.05, 0.1, 5.0  # of presses left out, mean: of full scale; the 0.1 mm
RMS_OF_MEAN = 1.25  # of normally distributed errors, over the mean of their sizes


class Fingertip(Estimator):
    """A tool on a fingertip with pins; a fit takes a log, or a folder of presses, `frames/` and `press.csv` each."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("fingertip",)
    is_reported = True
    needed = ("fingertip",)
    task = Turned("fingertip", "presses.toml", TASK.unit, TASK)

    def applies(self, board: Board) -> bool:
        return "fingertip" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        if job.baseline_mm is None:
            raise InputError("the distance of the two eyes is not known: give --baseline-mm")
        if len(job.paths) != 1:
            raise InputError(f"{len(job.paths)} logs: a fingertip is fitted to one log, or to one folder of presses")
        with press_roots(job.paths, job.board) as (root,):
            fit = fit_fingertip(job.board, root, job.baseline_mm, progress, only=job.pattern)
        tensors, metadata = tables(fit)
        job.tensors |= tensors
        job.metadata |= metadata
        off = fit.report["mean_error_of_presses_left_out"]["both"]
        return Outcome(
            "fitted",
            f"{fit.report['n_pins']} pins, {fit.report['n_presses']} presses; left out of the fit they err by "
            f"{off['force_n']:.3f} N, {off['way_mm']:.3f} mm deep, {off['x_mm']:.2f} and {off['y_mm']:.2f} mm aside, "
            f"{off['roll_deg']:.2f} and {off['pitch_deg']:.2f} degrees",
            fit.report,
        )

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """Of the presses left out."""
        if "n_presses" not in report:
            return []
        left = report["mean_error_of_presses_left_out"]["both"]
        tilt_deg = max(left["roll_deg"], left["pitch_deg"])
        return [
            at_least("presses", report["n_presses"], MIN_PRESSES, "presses"),
            part("force", left["force_n"] / report["largest_n"], MAX_FORCE, "of full scale: mean of presses left out"),
            at_most("way", left["way_mm"], MAX_WAY_MM, "mm, mean of presses left out"),
            at_most("tilt", tilt_deg, MAX_TILT_DEG, "degrees, mean of presses left out"),
        ]

    def allowed_n(self, report: dict[str, Any], force_n: float) -> float | None:
        left = report.get("mean_error_of_presses_left_out")
        return None if left is None else TIMES_RMS * RMS_OF_MEAN * float(left["both"]["force_n"])

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        tree, rows = tip_report_of(board, file, paths, previous, progress)
        if tree["log"]["in_the_fit"]:  # what its fit found on presses left out
            gates = gates_in(file) or []
        else:
            figures = {"both": tree["fingertip"]["mean"]}
            n = tree["log"]["touches"]
            gates = self.gates(
                {"n_presses": n, "largest_n": full_n(board), "mean_error_of_presses_left_out": figures}, board
            )
        tree |= {"passed": not failed(gates), "gates": [gate._asdict() for gate in gates]}
        mean = tree["fingertip"]["mean"]
        text = (
            f"off by {mean['force_n']:.3f} N, {mean['way_mm']:.3f} mm deep, {mean['roll_deg']:.2f} and "
            f"{mean['pitch_deg']:.2f} degrees over {tree['log']['touches']} presses"
        )
        return Report(tree, gates, text, lambda path: write_tip_page(path, file, tree, gates, rows))


FINGERTIP = Fingertip()
