"""`ruffini cal auto`: from a bench to a calibration in force, judged on touches that it never saw.

1. what to begin with: the previous calibration, or, for forces, colours by ball presses and the board's own numbers
2. in force, it is judged on touches that nothing is fitted to ("before")
3. what the board's estimator needs is collected and fitted; the page says how well
4. flashed where its gates pass and where, cross-validated, it errs by less than what the sensor said of the same
   touches meanwhile; else what was in force stays
5. the judged touches again: the error before and after

What was collected is kept: the same command goes on. Every step is the verb's own: a real daemon, a real serial line,
a stage that speaks G-code. With `--rig sim` camera, machine and reference are the twin's, and the judged error is
against its truth; on a bench it is against the reference.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.auto.page import write_auto_page
from ruffini.calibrate.auto.steps import Steps
from ruffini.calibrate.auto.truth import Truth
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.calibrate.fit.run import finished, gates_of_stages, run_stages
from ruffini.calibrate.gates import Gate, gates_in, need_passed
from ruffini.estimators.table import applying, reported_by
from ruffini.estimators.task import Counts, Task
from ruffini.files import read_array, write_array, write_whole
from ruffini.rig.bench import Bench
from ruffini.rig.collect import collect
from ruffini.rig.found import on_reference_clock, reference_in_pad
from ruffini.rig.log_file import Log, LogWriter, TouchRecord, read_log
from ruffini.rig.program import Item, Span, plan

Array = npt.NDArray[np.float64]
Say = Callable[[str], None]

JUDGED_SEED = 1000  # from the seed of what is fitted to that of what is judged
RESULT = "result.json"
BETTER = "than before"  # the gate that never lets a unit get worse


class Opened(NamedTuple):
    """A bench that is ready; what the twin does, where it is one."""

    bench: Bench
    truth: Truth | None


class Site(NamedTuple):
    """Whatever a bench is: opened for a program with a calibration in force and a seed, and where it presses."""

    open: Callable[[str, CalibrationFile | None, int], contextlib.AbstractContextManager[Opened]]
    span: Span
    tip: dict[str, Any] | None
    is_simulated: bool
    points: Path | None = None  # known points of a tube's lens
    baseline_mm: float | None = None  # between the eyes of a fingertip


@dataclass
class Auto:
    """One run; `folder` keeps logs, calibrations, pages and the result."""

    board: Board
    task: Task
    site: Site
    folder: Path
    counts: Counts
    seed: int
    say: Say
    previous: CalibrationFile | None = None
    force: bool = False
    is_quick: bool = False
    is_finite: bool = False  # the pad is fitted and solved at finite strain

    def __post_init__(self) -> None:
        self._step = Steps(self.folder, self.say)

    def run(self) -> dict[str, Any]:
        """All steps; what `--json` prints.

        Raises
        ------
        RefusedError
            The calibration fails its gates, or is no better than what is in force: that stays; the page says why.
        """
        start = time.monotonic()
        with self._step("first"):
            first = self.previous or self._first()
        with self._step("judged before"):
            before = None if first is None else self._judge(first, "before")
        with self._step("collect"):
            touches = self.task.fitted(self.site.span, self.counts.fitted, self.seed + 1)
            path = self._collect("fitted", self.task.program, touches, self.seed + 1, first)
        with self._step("fit and report"):
            file, gates = self._fit(path, first)
        is_passed = need_passed(gates, self.folder / "report.html", force=self.force)
        self._forget("after")
        with self._step("judged after"):
            after = self._judge(file, "after")
        result = {
            "board": self.board.name, "quick": self.is_quick, "task": self.task.name, "unit": self.task.unit,
            "simulated": self.site.is_simulated, "folder": str(self.folder), "presses": self.counts._asdict(),
            "seconds": self._step.seconds, "total_s": time.monotonic() - start, "sha256": file.sha256.hex(),
            "passed": is_passed, "before": before, "after": after, "clock": self._found_clock(),
            "gates": [gate._asdict() for gate in gates],
        }  # fmt: skip
        write_whole(self.folder / RESULT, json.dumps(result, indent=1).encode() + b"\n")
        write_auto_page(self.folder / "auto.html", result)
        return result

    def _found_clock(self) -> dict[str, Any] | None:
        path = self.folder / "fitted_clock.json"
        return json.loads(path.read_text()) if path.exists() else None

    def _forget(self, name: str) -> None:
        shutil.rmtree(self.folder / f"{name}.h5.parts", ignore_errors=True)
        for file in (f"{name}.h5", f"{name}_truth.npy", f"{name}_clock.json"):
            (self.folder / file).unlink(missing_ok=True)

    def _first(self) -> CalibrationFile | None:
        """Tables of the board's own numbers, and what their touches are fitted to first; None: begins with nothing."""
        done, job = self.folder / "before.safetensors", Job(self.board, [])
        if done.exists():
            return container.read(done)
        for estimator in applying(self.board):
            estimator.start(job)
        if not job.tensors:
            return None
        outcomes: dict[str, Outcome] = {}
        for estimator in applying(self.board):
            if program := estimator.first_program:
                touches = plan(program, self.site.span, self.counts.balls, self.seed)
                calibration = container.pack(job.tensors, job.header())
                job.paths = [self._collect(program, program, touches, self.seed, calibration)]
                outcomes[estimator.name] = outcome = estimator.fit(job, lambda _: None)
                self._tell(estimator.name, outcome)
        said = {"gates": [gate._asdict() for gate in gates_of_stages(self.board, outcomes)]}
        metadata = {**job.header(), **({"residuals": json.dumps(said)} if outcomes else {})}
        file = container.pack(job.tensors, metadata)
        container.write(done, file)
        return file

    def _fit(self, path: Path, first: CalibrationFile | None) -> tuple[CalibrationFile, list[Gate]]:
        parts = [first] if first is not None and self.previous is None else []
        job = Job(self.board, [path], self.previous, parts, points=self.site.points,
                  baseline_mm=self.site.baseline_mm, n_error_touches=self.counts.error_touches,
                  is_finite=self.is_finite)  # fmt: skip
        outcomes = run_stages(job, frozenset(), tell=lambda name, outcome, _: self._tell(name, outcome))
        more = [] if first is None else [self._than_before(path, outcomes)]
        more += [gate for part in parts for gate in gates_in(part) or []]
        file, gates = finished(job, outcomes, more=more)
        container.write(self.folder / "calibration.safetensors", file)
        reported_by(file).report(self.board, file, [path]).write_page(self.folder / "report.html")
        return file, gates

    def _than_before(self, path: Path, outcomes: dict[str, Outcome]) -> Gate:
        """Each touch by a fit without it, against what the sensor said of it with what was in force."""
        log = read_log(path)
        words = [self.task.word(self.board, log, t, _reference(log, t)) for t in log.touches]
        before, after = float(self.task.figures(words)["error"]), self.task.left_out(outcomes)
        if np.isnan(after):  # nobody knows: what is in force stays
            return Gate(BETTER, False, None, None, f"no touch left out tells ({self.task.unit}): collect more")
        if np.isnan(before):
            return Gate(
                BETTER, None, after, None, f"touches left out err by {after:.3g}, what was in force said nothing"
            )
        text = f"touches left out err by {after:.3g}, with what was in force by {before:.3g} {self.task.unit}"
        return Gate(BETTER, bool(after < before), after, before, text)

    def _tell(self, name: str, outcome: Outcome) -> None:
        for line in (f"{outcome.state}, {outcome.text}", *outcome.remarks):
            self.say(f"{name}: {line}")

    def _collect(
        self, name: str, program: str, touches: Sequence[Item], seed: int, calibration: CalibrationFile | None
    ) -> Path:
        """The log of a step; on a twin also its truth, where it was collected at one go."""
        path = self.folder / f"{name}.h5"
        facts = {
            "board": self.board.name, "program": program, "seed": seed, "n": len(touches), "tip": self.site.tip,
            "rig": "sim" if self.site.is_simulated else "bench", **self.site.span.facts,
        }  # fmt: skip
        if path.exists():
            self.say(f"{name}: {path} is there")
            return path
        writer = LogWriter(path, facts)
        is_new = not writer.done()
        with self.site.open(program, calibration, seed) as (bench, truth):
            collect(bench, touches, writer, tell=lambda p: self.say(f"{name} {p.n_done}/{p.n_total} {p.text}"))
        if truth is not None and is_new:
            log = read_log(path)
            write_array(self.folder / f"{name}_truth.npy", np.concatenate([truth.of(t) for t in log.touches]))
            write_whole(self.folder / f"{name}_clock.json", json.dumps(clock_error(log, truth)).encode())
        return path

    def _judge(self, file: CalibrationFile, name: str) -> dict[str, Any]:
        """The same touches each time, of a seed that nothing is fitted to."""
        seed, known = self.seed + JUDGED_SEED, self.folder / f"{name}_truth.npy"
        if self.site.is_simulated and not known.exists():  # the truth of what was not finished is lost
            self._forget(name)
        touches = self.task.judged(self.site.span, self.counts.judged, seed)
        log = read_log(self._collect(name, self.task.program, touches, seed, file))
        if known.exists():
            ends = np.cumsum([len(t.arrays["stream_s"]) for t in log.touches])[:-1]
            true, against = np.split(np.asarray(read_array(known), float), ends), "the twin's truth"
        else:
            true, against = [_reference(log, t) for t in log.touches], "the reference"
        figures = self.task.figures([
            self.task.word(self.board, log, touch, rows) for touch, rows in zip(log.touches, true, strict=True)
        ])  # fmt: skip
        self.say(f"{name}: off by {figures['error']:.3g} {self.task.unit}, up to {figures['largest_force_n']:.2f} N")
        return {**figures, "against": against}


def clock_error(log: Log, truth: Truth) -> dict[str, Any]:
    """How far off the clock offset is that a log found, and what it says of itself, ms; or why none was found."""
    (clock,) = log.found["clocks"]
    if "offset_s" not in clock:
        return {"why_not": clock["why_not"]}
    return {"error_ms": 1e3 * (clock["offset_s"] - truth.offset_s(log)), "sigma_ms": 1e3 * clock["sigma_s"]}


def _reference(log: Log, touch: TouchRecord) -> Array:
    """What the reference says of each frame of a touch's stream, (t, 6)."""
    when, wrench = on_reference_clock(log, touch), reference_in_pad(log, touch)
    return np.stack([np.interp(when, touch.arrays["reference_s"], column) for column in wrench.T], axis=1)
