"""Wrench, depth, area, kind of contact and hardness of a texture's flow, as `cal fit --only contact` fits them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import MAX_WRENCH_ERROR, MIN_PRESSES, Gate, at_least, at_most, part
from ruffini.estimators.base import Estimator, Report
from ruffini.estimators.contact_model.command import COMMAND
from ruffini.estimators.contact_model.task import MAX_SHORE_A, TASK
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.wrench.log import features_of
from ruffini.estimators.wrench.report import wrench_report
from ruffini.tables import aligned

MAX_GEL_MM = 0.2  # gel depth: the paper's own uncertainty of it
MIN_KIND = 0.8  # of presses whose kind, planar or Hertzian, is told right


class ContactModel(Estimator):
    """A texture's contact; the board's wrench is fitted here, too."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("contact_model", "contact_depth", "wrench")
    is_reported = True
    needed = ("contact_model", "wrench")
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
            _tables_of(report),
        )

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
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

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        """Judge its wrench by the normal force: straight presses hardly load the other axes."""
        return wrench_report(board, file, paths, previous, judged=("Fz",))


def _tables_of(report: dict[str, Any]) -> str:
    """The errors on sizes and shapes that were not fitted, for a person."""
    head = ("Fn N", "Ft N", "M N m", "gel mm", "press mm", "Shore A", "kind %")
    keys = ("normal_n", "tangential_n", "moment_nm", "gel_depth_mm", "press_depth_mm", "shore_a")
    parts: list[str] = []
    for what in ("sizes", "shapes"):
        rows = [
            (shape, *(f"{r[key]:.3g}" for key in keys), f"{100 * r['kind_right']:.0f}")
            for shape, r in report[f"left_out_{what}"].items()
        ]
        parts += aligned((f"RMSE on {what} that were not fitted", *head), rows)
    if (depth_map := report["depth_map"]) is not None:
        each = [(shape, f"{under:.2f}") for shape, under in depth_map["under_mm"].items()]
        beside = ("beside the contact", f"{depth_map['beside_mm']['all']:.2f}")
        parts += aligned(("depth map of presses that were not fitted, RMSE", "mm"), [*each, beside])
    refused = [
        (name, f"{100 * share:.0f} % of {what}") for name, shares in report["refused"].items()
        for what, share in shares.items()
    ]  # fmt: skip
    if refused:
        parts += aligned(("no model holds for", "refused, of presses that were not fitted"), refused)
    return "\n".join(parts)


CONTACT = ContactModel()
