"""Wrench, depth, area, kind of contact and hardness of a texture's flow, as `cal fit --only contact` fits them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MAX_WRENCH_ERROR, MIN_PRESSES, Gate, at_least, at_most, part
from ruffini.estimators.base import Estimator
from ruffini.estimators.contact_model.task import TASK
from ruffini.estimators.wrench.log import features_of

MAX_GEL_MM = 0.2  # gel depth: the paper's own uncertainty of it
MAX_SHORE_A = 16.0  # hardness: twice what the paper has, since few presses begin with more
MIN_KIND = 0.8  # of presses whose kind, planar or Hertzian, is told right


class ContactModel(Estimator):
    """A texture's contact; the board's wrench is fitted here, too."""

    name = "contact"
    kinds = ("contact_model", "contact_depth", "wrench")
    needs_previous = True
    task = TASK

    def applies(self, board: Board) -> bool:
        return "contact_model" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit to presses of known shapes, sizes and hardness; errors on sizes and shapes left out."""
        from ruffini.estimators.contact_model.log import read_presses
        from ruffini.estimators.contact_model.tables import fit_contact, tables
        from ruffini.estimators.contact_model.touches import presses_of_log

        folders = [path for path in job.paths if path not in job.logs()]
        presses = [press for path in job.logs() for press in presses_of_log(path, job.board)]
        if folders:
            presses += read_presses(folders, job.board, progress=lambda done: progress(0.3 * done))
        fit = fit_contact(job.board, presses, lambda done: progress(0.3 + 0.7 * done))
        tensors, metadata = tables(job.board, fit, features_of(job.board))
        report = json.loads(metadata["residuals"])
        report["largest_n"] = float(max(np.abs(p.force[:, 2]).max() for p in presses))
        job.tensors |= tensors
        job.metadata |= {name: text for name, text in metadata.items() if name.split(".")[0] in self.kinds}
        left = report["left_out_sizes"]["all"]
        return Outcome(
            "fitted",
            f"{report['n_presses']} presses; on sizes left out they err by {left['normal_n']:.2f} N, "
            f"{left['gel_depth_mm']:.2f} mm and {left['shore_a']:.1f} Shore A, kind right "
            f"in {100 * left['kind_right']:.0f} %",
            report,
        )

    def gates(self, report: dict[str, Any], board: Board) -> list[Gate]:
        """Each size judged by a fit without it."""
        if "left_out_sizes" not in report:
            return []
        left = report["left_out_sizes"]["all"]
        force = left["normal_n"] / report["largest_n"]
        return [
            at_least("presses", report["n_presses"], MIN_PRESSES, "presses"),
            part("contact force", force, MAX_WRENCH_ERROR, "of the largest normal force: RMS of sizes left out"),
            at_most("contact depth", left["gel_depth_mm"], MAX_GEL_MM, "mm, RMS of sizes left out"),
            at_most("contact hardness", left["shore_a"], MAX_SHORE_A, "Shore A, RMS of sizes left out"),
            at_least("contact kind", left["kind_right"], MIN_KIND, "of the presses left out told right"),
        ]


CONTACT = ContactModel()
