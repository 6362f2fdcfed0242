"""Force and place on a skin that glows where it is pressed, as `ruffini cal fit --only skin` fits them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MIN_PRESSES, Gate, at_least, covered, part
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator, Report
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.skin.command import COMMAND
from ruffini.estimators.skin.fit import SeenSkin, fit_seen, read_points, seen_skin, taxel_file, untouched
from ruffini.estimators.skin.judge import MAX_SKIN_ERROR, gates_of_skin, judged_presses
from ruffini.estimators.skin.log import log_presses, read_skin_log, untouched_of
from ruffini.estimators.skin.presses import Press, press_folders, read_presses
from ruffini.estimators.skin.report import skin_report_of, write_skin_page
from ruffini.estimators.skin.task import TASK
from ruffini.rig.log_file import Log

Array = npt.NDArray[np.float64]

MAX_SKIN_PLACE = 0.5  # of the distance of two openings, mean: nearer to the right one than to the next


def _untouched(board: Board, path: Path, log: Log | None) -> Array:
    return untouched(board, press_folders(path)[0]) if log is None else untouched_of(log, path.name, board)


def _presses(board: Board, path: Path, log: Log | None, seen: SeenSkin) -> list[Press]:
    return (
        read_presses(path, board, seen.openings) if log is None else log_presses(log, path.name, board, seen.openings)
    )


class SkinEstimator(Estimator):
    """Force and place on a glowing skin."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("skin", "relaxation")
    is_reported = True
    needed = ("skin",)
    task = TASK

    def applies(self, board: Board) -> bool:
        return "skin" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit to logs of `cal collect` and folders of presses, all of one unit."""
        if job.points is None:
            raise InputError("the lens is fitted to known points: give --points FILE (CSV: x_px, y_px, z_mm)")
        seen: SeenSkin | None = None
        presses: list[Press] = []
        for i, path in enumerate(job.paths):
            log = read_skin_log(path, job.board) if path.suffix == ".h5" else None
            seen = seen or seen_skin(job.board, read_points(job.points), _untouched(job.board, path, log))
            presses += _presses(job.board, path, log, seen)
            progress(0.5 * (i + 1) / len(job.paths))
        assert seen is not None
        fit = fit_seen(job.board, seen, presses, lambda done: progress(0.5 + 0.5 * done))
        file = taxel_file(job.board, fit)
        job.tensors |= file.tensors
        job.metadata |= {k: v for k, v in file.metadata.items() if k.split(".")[0] in self.kinds}
        r = fit.report
        return Outcome(
            "fitted",
            f"{r['n_taxels']} taxels, {r['n_presses']} presses; left out of the fit they err by "
            f"{r['force_error_percent']:.1f} % in force above 2 N and {r['place_error_mm']:.2f} mm in place; points "
            f"{r['points_rmse_px']:.2f} px; stray light is told by {fit.openings.n_patches} black patches",
            r,
        )

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """Each press judged by a fit without it."""
        if "n_presses" not in report:
            return []
        force, place = report["force_error_percent"] / 100, report["place_error_mm"] / report["pitch_mm"]
        n, n_at_rim, remedy = report["n_presses"], report["n_at_rim"], ""
        if force > MAX_SKIN_ERROR and 2 * n_at_rim > n:
            remedy = f"; {n_at_rim} of {n} presses are at a rim, where a panel's edge bears too: press inside as often"
        return [
            at_least("touches", n, MIN_PRESSES, "touches"),
            covered(report["coverage"], "of the skin's parts"),
            part("skin force", force, MAX_SKIN_ERROR, f"of the force: mean of presses left out, above 2 N{remedy}"),
            part("skin place", place, MAX_SKIN_PLACE, "of the openings' distance: mean of presses left out"),
        ]

    def gates_of_log(self, job: Job, file: CalibrationFile) -> list[Gate]:
        logs = job.logs()
        return gates_of_skin(judged_presses(job.board, file, logs)) if logs else []

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        made = skin_report_of(board, file, paths, previous=previous, progress=progress)
        off_n, n = made.tree["skin"]["force_rmse_n"], made.tree["log"]["touches"]
        text = f"force off by {off_n:.2f} N RMS over {n} touches"
        return Report(made.tree, made.gates, text, lambda path: write_skin_page(path, file, made))


SKIN = SkinEstimator()
