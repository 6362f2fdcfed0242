"""Force and place on a skin that glows where it is pressed, as `ruffini cal fit --only skin` fits them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress, Stage
from ruffini.errors import InputError
from ruffini.estimators.skin.fit import SeenSkin, fit_seen, read_points, seen_skin, taxel_file, untouched
from ruffini.estimators.skin.log import log_presses, read_skin_log, untouched_of
from ruffini.estimators.skin.presses import Press, press_folders, read_presses

Array = npt.NDArray[np.float64]

KINDS = ("skin", "relaxation")  # of a skin's own calibration


def run(job: Job, progress: Progress) -> Outcome:
    """Fit to logs of `cal collect` and folders of presses, all of one unit."""
    if job.points is None:
        raise InputError("the lens is fitted to known points: give --points FILE (CSV: x_px, y_px, z_mm)")
    seen = seen_skin(job.board, read_points(job.points), _untouched(job.board, job.paths[0]))
    presses: list[Press] = []
    for i, path in enumerate(job.paths):
        presses += _presses(job.board, path, seen)
        progress(0.5 * (i + 1) / len(job.paths))
    fit = fit_seen(job.board, seen, presses, lambda done: progress(0.5 + 0.5 * done))
    file = taxel_file(job.board, fit)
    job.tensors |= file.tensors
    job.metadata |= {k: v for k, v in file.metadata.items() if k.split(".")[0] in KINDS}
    r = fit.report
    return Outcome(
        "fitted",
        f"{r['n_taxels']} taxels, {r['n_presses']} presses; left out of the fit they err by "
        f"{r['force_error_percent']:.1f} % in force above 2 N and {r['place_error_mm']:.2f} mm in place; points "
        f"{r['points_rmse_px']:.2f} px; stray light is told by {fit.openings.n_patches} black patches",
        r,
    )


def _untouched(board: Board, path: Path) -> Array:
    if path.suffix == ".h5":
        return untouched_of(read_skin_log(path, board), path.name, board)
    return untouched(board, press_folders(path)[0])


def _presses(board: Board, path: Path, seen: SeenSkin) -> list[Press]:
    if path.suffix == ".h5":
        return log_presses(read_skin_log(path, board), path.name, board, seen.openings)
    return read_presses(path, board, seen.openings)


def keep(job: Job) -> Outcome:
    """The previous calibration's."""
    taken = job.take("skin")
    if taken is None:
        raise InputError("--skip skin needs a calibration that has one: give --previous FILE")
    job.take("relaxation")
    return taken


def is_needed(job: Job) -> bool:
    """Whether the board's surface glows."""
    return "skin" in job.board.pipeline.stages


STAGE = Stage("skin", is_needed, run, keep)
