"""Wrench, depth, area, kind of contact and hardness of a texture's flow, as `cal fit --only contact` fits them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from ruffini.calibrate.fit.job import Job, Outcome, Progress, Stage
from ruffini.errors import InputError
from ruffini.estimators.wrench.log import features_of

if TYPE_CHECKING:
    from ruffini.boards import Board

KINDS = ("contact_model", "contact_depth", "wrench")


def is_of(board: Board) -> bool:
    """Whether the board's contact is told by contact models; its wrench is then fitted here, too."""
    return "contact_model" in board.pipeline.stages


def run(job: Job, progress: Progress) -> Outcome:
    """Fit to logs and folders of presses of known shapes, sizes and hardness; errors on sizes and shapes left out."""
    from ruffini.estimators.contact_model.log import read_presses
    from ruffini.estimators.contact_model.tables import fit_contact, tables
    from ruffini.estimators.contact_model.touches import presses_of_log

    logs = [path for path in job.paths if path.suffix == ".h5"]
    folders = [path for path in job.paths if path.suffix != ".h5"]
    presses = [press for path in logs for press in presses_of_log(path, job.board)]
    if folders:
        presses += read_presses(folders, job.board, progress=lambda done: progress(0.3 * done))
    fit = fit_contact(job.board, presses, lambda done: progress(0.3 + 0.7 * done))
    tensors, metadata = tables(job.board, fit, features_of(job.board))
    report = json.loads(metadata["residuals"])
    report["largest_n"] = float(max(np.abs(p.force[:, 2]).max() for p in presses))
    job.tensors |= tensors
    job.metadata |= {name: text for name, text in metadata.items() if name.split(".")[0] in KINDS}
    left = report["left_out_sizes"]["all"]
    return Outcome(
        "fitted",
        f"{report['n_presses']} presses; on sizes left out they err by {left['normal_n']:.2f} N, "
        f"{left['gel_depth_mm']:.2f} mm and {left['shore_a']:.1f} Shore A, kind right "
        f"in {100 * left['kind_right']:.0f} %",
        report,
    )


def keep(job: Job) -> Outcome:
    """The previous calibration's."""
    taken = [job.take(kind) for kind in KINDS]
    if taken[0] is None or taken[2] is None:
        raise InputError("--skip contact needs a calibration that has one: give --previous FILE")
    return taken[0]


STAGE = Stage("contact", lambda job: is_of(job.board), run, keep)
