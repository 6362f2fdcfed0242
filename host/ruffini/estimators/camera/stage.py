"""The camera map: no log of touches holds pictures of a target, so `cal fit --only camera` is given them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruffini.boards import Board
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_most
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator
from ruffini.estimators.camera.command import COMMAND, CameraOptions
from ruffini.estimators.camera.fit import fit_camera, tables
from ruffini.estimators.camera.targets import Target
from ruffini.estimators.camera.views import fit_views, view_kinds
from ruffini.estimators.camera.views import tables as tables_of_views
from ruffini.frames import image_files

MAX_CAMERA_PX = 1.0


def _several(job: Job, paths: list[Path], shown: Target, options: CameraOptions, views: str) -> Outcome:
    """Of an image in which several views stand side by side."""
    kinds = view_kinds(views)
    if options.on_pad is None:
        raise InputError("--views needs --on-pad: one picture in which all views see the target lying on the pad")
    fit = fit_views(
        paths, shown, job.board, kinds, is_fisheye=options.fisheye, on_pad=options.on_pad, index=options.index
    )
    tensors, metadata = tables_of_views(fit, job.board)
    job.tensors |= tensors
    job.metadata |= metadata
    report = fit.report()
    each = "; ".join(f"{v['kind']}: {v['pictures']} pictures, {v['residual_px']:.3f} px" for v in report["views"])
    return Outcome(
        "fitted",
        f"{each}; on the pad the rays of two views meet {report['height_um']:.1f} um off its height (RMS of "
        f"{report['points']} points), {report['gap_um']:.1f} um apart",
        report,
    )


class Camera(Estimator):
    """The map of the optics: taken as given, but of pictures of its own."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("camera", "views")

    def applies(self, board: Board) -> bool:
        return True  # each has a pinhole at least

    def fit(self, job: Job, _: Progress) -> Outcome:
        """Take the map that was given, or the previous one."""
        return self.keep(job)

    def fit_alone(self, job: Job, options: CameraOptions, progress: Progress) -> Outcome:
        """Fit lens, mounting and refraction to pictures of a flat target."""
        columns, _, rows = options.size.partition("x")
        if not (columns.isdecimal() and rows.isdecimal()):
            raise InputError(f"--size {options.size!r}: give COLUMNSxROWS, e.g. 9x6")
        paths = image_files(job.paths[0]) if len(job.paths) == 1 and job.paths[0].is_dir() else job.paths
        shown = Target(options.target, int(columns), int(rows), options.pitch_mm, options.dictionary)
        if options.views is not None:
            return _several(job, paths, shown, options, options.views)
        fit = fit_camera(
            paths, shown, job.board, is_fisheye=options.fisheye, on_pad=options.on_pad, index=options.index
        )
        tensors, metadata = tables(fit.model, job.board)
        job.tensors |= tensors
        job.metadata |= metadata
        report = fit.report()
        skipped = f", none in {', '.join(report['skipped'])}" if report["skipped"] else ""
        return Outcome(
            "fitted",
            f"{report['model']} lens from {report['views']} views, {report['points']} points{skipped}; "
            f"residual {report['residual_px']:.3f} px = {report['residual_um']:.1f} um of pad, worst view "
            f"{report['worst_view_px']:.3f} px; mounting "
            + ("measured on the pad" if report["is_measured_on_pad"] else "as in board.toml"),
            report,
        )

    def keep(self, job: Job) -> Outcome:
        """The same: there is nothing to fit here."""
        taken = [job.take(kind) for kind in self.kinds]
        return next((one for one in taken if one is not None), Outcome("board", "pinhole of board.toml"))

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """Of one view or several."""
        if "views" not in report:
            return []
        views = report["views"] if isinstance(report["views"], list) else [report]
        worst = max(view["residual_px"] for view in views)
        return [at_most("camera", worst, MAX_CAMERA_PX, "px RMS of the target's points")]


CAMERA = Camera()
