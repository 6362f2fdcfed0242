"""An estimator: one object that states all that the rest of the host asks about it.

`cal collect`, `fit`, `report`, `auto` and `check` loop over these objects (`ruffini.estimators.table`), so that none of
them knows one by name.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome, Progress
from ruffini.calibrate.gates import Gate
from ruffini.errors import InputError
from ruffini.estimators.command import Command
from ruffini.estimators.material.prior import Prior
from ruffini.estimators.task import Task, Turned

TIMES_RMS = 3.0  # exceeded by three in a thousand of normally distributed errors


class Report(NamedTuple):
    """A calibration judged on logs."""

    tree: dict[str, Any]  # of the JSON: passed, gates, log, accuracy_of_presses, valid_for, and figures of its own
    gates: list[Gate]
    text: str  # its errors, in one line
    write_page: Callable[[Path], None]  # HTML


class Estimator:
    """Something that the board estimates or needs for it, fitted to logs of known touches. Subclasses override."""

    name: ClassVar[str]  # of `cal fit --only NAME`, and in a file's manifest
    command: ClassVar[Command | None] = None  # words and options of `cal fit --only NAME`; None: those of `cal fit`
    makes_numbers: ClassVar[bool] = False  # `--only NAME` writes them as JSON, for the operator, and no tables
    kinds: ClassVar[tuple[str, ...]] = ()  # of a calibration file that it makes; the first one is its own
    is_reported: ClassVar[bool] = False  # a file with `kinds[0]` is judged by `report`
    fits_from_prior: ClassVar[bool] = False  # `fit` begins with a fleet's numbers
    fits_from_calibration: ClassVar[bool] = False  # `fit` begins with a calibration of other units
    takes_prior: ClassVar[bool] = False  # `report` begins its fits of fewer presses with a fleet's numbers
    needed: ClassVar[tuple[str, ...]] = ()  # kinds of `kinds` that nothing stands in for if a fit leaves it out
    task: ClassVar[Task | Turned | None] = None  # of any board (`task_of`)
    first_program: ClassVar[str] = ""  # touches that it is fitted to before the task's, with a bench that has nothing

    def applies(self, board: Board) -> bool:
        """True if the board's stages use what it makes."""
        raise NotImplementedError

    def is_used(self, board: Board) -> bool:
        """True if the board's stages use it, also where another estimator makes it."""
        return self.applies(board)

    def fit(self, job: Job, progress: Progress) -> Outcome:
        """Fit to the job's logs; tensors, metadata and numbers for the estimators after it go to the job."""
        raise NotImplementedError

    def fit_alone(self, job: Job, options: Any, progress: Progress) -> Outcome:
        """Fit for `cal fit --only NAME`, whose inputs some have to themselves; `options`: of `command`."""
        return self.fit(job, progress)

    def keep(self, job: Job) -> Outcome:
        """Stand in for a fit that is left out: what was given, else the previous calibration's, else the board's."""
        taken = {kind: job.take(kind) for kind in self.kinds}
        missing = [kind for kind in self.needed if taken[kind] is None]
        if missing:
            raise InputError(
                f"--skip {self.name} needs a calibration with {' and '.join(self.needed)}, and no file that was given "
                f"has {' or '.join(missing)}: give one that does as --previous FILE"
            )
        return taken[self.kinds[0]] or Outcome("board", "none")

    def start(self, job: Job) -> None:
        """Make the tables that follow from the board alone, before there is a log; most have none."""

    def task_of(self, board: Board) -> Task | Turned | None:
        """What a bench presses for it; None: it is fitted to others' touches."""
        return self.task

    def gates(self, report: dict[str, Any], board: Board | None) -> list[Gate]:
        """Judge the report of its fit, on what the fit left out."""
        return []

    def gates_of_log(self, job: Job, file: CalibrationFile) -> list[Gate]:
        """Judge the finished file on the job's log, on the board's own integers."""
        return []

    def report(
        self, board: Board, file: CalibrationFile, paths: list[Path], *, previous: CalibrationFile | None = None,
        fleet: Prior | None = None, progress: Progress = lambda _: None,
    ) -> Report:  # fmt: skip
        """Judge a calibration on logs: those that it was fitted to, or others."""
        raise NotImplementedError

    def allowed_n(self, report: dict[str, Any], force_n: float) -> float | None:
        """Largest error of a force (N) that its fit's report lets `cal check` expect; None: not stated.

        It grows with the force, above what it is where the force is faint.
        """
        if "force_rms_percent" not in report:
            return None
        return TIMES_RMS * max(float(report["force_rms_percent"]) / 100 * force_n, float(report["light_force_rms_n"]))

    def need(self, file: CalibrationFile, where: Path) -> None:
        """Raises InputError if a file has no table of this estimator."""
        if self.kinds[0] not in file.kinds:
            raise InputError(
                f"{where} has no {self.kinds[0]} table: make one with `ruffini cal fit --only {self.name}`"
            )
