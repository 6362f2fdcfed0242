"""Colours to slope, or brightness to depth: fitted to ball presses; with a handful of them the previous colour table is
adapted by one factor.

The presses come from a folder (`--balls`), or from the pictures that a log holds of straight presses with a ball.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container, keys
from ruffini.calibrate.container import Tensors
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate, at_least, at_most, near, part
from ruffini.errors import InputError
from ruffini.estimators.base import Estimator
from ruffini.estimators.camera.stage import CAMERA
from ruffini.estimators.dark.frame import dark_of
from ruffini.estimators.dark.stage import DARK
from ruffini.estimators.photometric.command import COMMAND, PhotometricOptions
from ruffini.estimators.photometric.fit import collect_samples
from ruffini.estimators.photometric.fitted import fit_presses
from ruffini.estimators.photometric.pad_view import pad_view
from ruffini.estimators.photometric.presses import PressSet, load_presses
from ruffini.estimators.photometric.scale import fit_scale, scaled
from ruffini.evaluate.press_report import write_report
from ruffini.rig.log_file import Log, read_log
from ruffini.rig.program import SCALE

STRAIGHT = ("press", SCALE, "hand")  # kinds of touches: of a stage, and of a person
MAX_NORMAL_DEG = 7.0  # of ball presses left out, median: what recorded presses of a good unit reach
MIN_PLACES = 3  # forty copies of one press are one press
MAX_CAP = 0.05  # of the ball's diameter
MAX_SCALE = 1.3  # times the board's pixels a millimetre: mounting and lens of a unit differ by less
ENOUGH = 12  # presses for a table of its own; with fewer a previous one is only scaled


def _adapted(job: Job, n: int, fit: tuple[float, float, float, float]) -> Outcome:
    scale, sigma, before_deg, after_deg = fit
    tables: Tensors = {k: v for k, v in job.tensors.items() if k.startswith("photometric.")}
    job.tensors |= scaled(tables, scale)
    report = {"scale": scale, "scale_sigma": sigma, "n_presses": n, "normal_before_deg": before_deg,
              "normal_after_deg": after_deg}  # fmt: skip
    return Outcome("fitted", f"the previous table times {scale:.3f} +- {sigma:.3f} ({n} presses): normals "
                   f"{before_deg:.2f} -> {after_deg:.2f} deg", report)  # fmt: skip


def _taken(job: Job) -> Outcome:
    taken = job.take("photometric")
    if taken is None and "operator" not in job.board.pipeline.stages:
        return Outcome("open", "nothing gives this board its colours: it measures no depth")
    if taken is None:
        raise InputError(
            "nothing gives this board its colours: add ball presses (--balls DIR), "
            "a file of `ruffini cal fit --only photometric` "
            "(--with FILE), or the calibration before (--previous FILE)"
        )
    return taken


def _presses(job: Job, folder: Path) -> PressSet | None:
    if job.balls is not None:
        return load_presses(job.balls, may_find=True, at_least=1 if job.previous is not None else 3)
    logs = [read_log(path) for path in job.logs()]
    n = sum(_write_presses(log, folder, i) for i, log in enumerate(logs))
    if not n or (n < ENOUGH and job.previous is None and not job.parts):
        return None
    tip = next(log.facts["tip"] for log in logs if _is_ball(log))
    camera = job.board.camera
    px_per_mm = camera.focal_mpx / camera.standoff_um
    return load_presses(folder, ball_mm=2e3 * tip["radius_m"], px_per_mm=px_per_mm, may_find=True, at_least=1)


def _is_ball(log: Log) -> bool:
    tip = log.facts.get("tip")
    return isinstance(tip, dict) and tip.get("shape") == "sphere" and "radius_m" in tip


def _write_presses(log: Log, folder: Path, number: int) -> int:
    """The pictures of a log's straight presses as a folder of presses; how many."""
    if not _is_ball(log):
        return 0
    n = 0
    for i, touch in enumerate(log.touches):
        image, facts = touch.arrays.get("image"), touch.facts
        is_sheared = facts.get("shear_x_m", 0) or facts.get("shear_y_m", 0)
        is_straight = facts.get("kind", STRAIGHT[0]) in STRAIGHT and not is_sheared
        if image is None or len(image) < 2 or facts.get("image_step_px", 1) != 1 or not is_straight:
            continue
        _write(folder / f"reference_{number}_{i:04d}.png", image[0])
        _write(folder / "press" / f"{number}_{i:04d}.png", image[-1])
        n += 1
    return n


def _write(path: Path, image: npt.NDArray[np.uint8]) -> None:
    path.parent.mkdir(exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise InputError(f"{path} cannot be written: make room in the folder for temporary files (TMPDIR)")


class Photometric(Estimator):
    """Colours to slopes, or brightness to depth."""

    name = COMMAND.name
    command = COMMAND
    kinds = ("photometric",)
    first_program = "balls"

    def applies(self, board: Board) -> bool:
        return "photometric" in board.pipeline.stages

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit, adapt, or take what there is.

        Raises
        ------
        InputError
            No presses, no table that was given, no previous one.
        """
        if job.balls is None and any("photometric" in part.kinds for part in job.parts):
            return _taken(job)
        try:
            return self._fitted(job, progress)
        except InputError as error:
            if job.balls is not None or "operator" in job.board.pipeline.stages:
                raise
            taken = _taken(job)  # depth is not what the log was collected for
            return taken._replace(text=f"{taken.text}; the log's presses give none: {error}")

    def fit_alone(self, job: Job, options: PhotometricOptions, progress: Progress) -> Outcome:
        """Fit to a folder of ball presses, seen with camera and dark frame that the sensor will have."""
        seen = Job(job.board, [], job.previous)
        for estimator, path in ((CAMERA, options.camera), (DARK, options.dark)):
            seen.parts = []
            if path is not None:
                seen.parts = [keys.read_verified(path)]
                container.check_board(seen.parts[0], job.board)
                estimator.need(seen.parts[0], path)
            estimator.keep(seen)
        presses = load_presses(
            job.path(), ball_mm=options.ball_mm, px_per_mm=options.px_per_mm, truth=options.truth, may_find=True,
            at_least=1,
        ).less(dark_of(seen.tensors))  # fmt: skip
        view = pad_view(job.board, seen.tensors, seen.metadata)
        fit = fit_presses(presses, job.board, is_foreign=options.foreign, source=options.source, view=view,
                          progress=progress)  # fmt: skip
        job.tensors |= fit.tensors
        job.metadata |= fit.metadata
        files = () if options.report is None else write_report(options.report, presses, fit, job.board, progress)
        return Outcome("fitted", fit.summary, fit.report, files=tuple(files))

    def _fitted(self, job: Job, progress: Progress) -> Outcome:
        """Of ball presses."""
        with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
            presses = _presses(job, Path(folder))
            if presses is None:
                return _taken(job)
            job.has_new_colours = True
            presses = presses.less(dark_of(job.tensors))
            view, n = pad_view(job.board, job.tensors, job.metadata), len(presses.presses)
            if n < ENOUGH and job.take("photometric") is not None and "photometric.unmix" in job.tensors:
                return _adapted(job, n, fit_scale(job.tensors, collect_samples(presses, view)))
            fit = fit_presses(presses, job.board, is_foreign=False, view=view, progress=progress)
        job.tensors = {k: v for k, v in job.tensors.items() if not k.startswith("photometric.")} | fit.tensors
        job.metadata["optics"] = job.board.camera.optics
        return Outcome("fitted", fit.summary, fit.report)

    def keep(self, job: Job) -> Outcome:
        """What was given, or the previous calibration's."""
        return _taken(job)

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """Normals or depth of presses left out, number of places, scale."""
        if "n_places" not in report:  # a table that was adapted or taken
            return []
        gates = [at_least("places", report["n_places"], MIN_PLACES, "different places or depths")]
        if "held_out_normal_median_deg" in report:
            off_deg = float(report["held_out_normal_median_deg"])
            gates.append(at_most("normals", off_deg, MAX_NORMAL_DEG, "deg, median of ball presses left out"))
        elif (held_out := report.get("held_out_cap_rms_mm")) is not None:
            off = held_out / report["ball_mm"]
            gates.append(part("depth", off, MAX_CAP, "of the ball's diameter: RMS of presses left out"))
        else:
            gates.append(Gate("depth", None, None, None, "one press: none can be left out"))
        if report.get("scale_of_board") is not None:
            gates.append(near("scale", report["scale_of_board"], MAX_SCALE, "of the board's pixels a millimetre"))
        return gates


PHOTOMETRIC = Photometric()
