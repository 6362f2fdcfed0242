"""`ruffini cal auto`: from a bench to a calibration in force, judged on touches that it never saw.

1. ball presses -> colours; with the board's own numbers: the calibration to begin with ("before")
2. flash it, press the judged touches
3. press a grid, fit, report; flash where the gates pass
4. press the judged touches again: the error before and after

What was collected is kept: the same command goes on. Every step is the verb's own: a real daemon, a real serial line,
a stage that speaks G-code. With `--rig sim` camera, machine and reference are the twin's, and the judged error is
against its truth; on a bench it is against the reference.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit import finished, run_stages
from ruffini.calibrate.gates import failed
from ruffini.calibrate.gauge import gauge_uncertainty_m
from ruffini.calibrate.operator import make_operator
from ruffini.calibrate.report import report_of
from ruffini.calibrate.report_page import write_page
from ruffini.calibrate.stages import photometric
from ruffini.calibrate.stages.job import Job, Outcome
from ruffini.calibrate.stages.material import SIGMA_M, TILT_M
from ruffini.errors import InputError, RefusedError
from ruffini.fem.operators import Noise
from ruffini.files import read_array, write_array
from ruffini.rig.bench import Bench
from ruffini.rig.collect import collect
from ruffini.rig.found import is_settled, reference_in_pad
from ruffini.rig.log_file import Log, LogWriter, TouchRecord, read_log
from ruffini.rig.program import Span, Touch, plan

Array = npt.NDArray[np.float64]
Say = Callable[[str], None]


class Counts(NamedTuple):
    """Touches of each step, and simulated ones behind the stated uncertainty."""

    balls: int
    grid: int
    judged: int
    error_touches: int


FITTED_PART = 0.7  # of the span, in which the material's touches lie; the judged ones are all over it
FITTED = ("balls", "grid")  # logs that something is fitted to; the others are judged
WHOLE, QUICK = Counts(30, 40, 20, 120), Counts(16, 16, 6, 40)


class Opened(NamedTuple):
    """A bench that is ready; the true wrench at a host time where somebody knows it."""

    bench: Bench
    truth: Truth | None


@dataclass
class Truth:
    """What the twin did, frame by frame: host times and wrenches."""

    time_s: list[float] = field(default_factory=list)
    wrench: list[Array] = field(default_factory=list)

    def note(self, _: int, wrench: Array) -> None:
        """A listener of the twin."""
        self.time_s.append(time.monotonic())
        self.wrench.append(wrench.copy())

    def of(self, touch: TouchRecord) -> Array:
        """Mean over the end of a touch's hold, (6,)."""
        held = is_settled(np.array(self.time_s), touch.facts)
        return np.asarray(np.array(self.wrench)[held].mean(axis=0))


class Site(NamedTuple):
    """Whatever a bench is: opened for a program with a calibration in force, and where it presses."""

    open: Callable[[str, CalibrationFile], contextlib.AbstractContextManager[Opened]]
    span: Span
    tip: dict[str, Any] | None
    is_simulated: bool


@dataclass
class Auto:
    """One run; `folder` keeps logs, calibrations and the page."""

    board: Board
    site: Site
    folder: Path
    counts: Counts
    seed: int
    say: Say
    force: bool = False
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self) -> dict[str, Any]:
        """All steps; what `--json` prints.

        Raises
        ------
        RefusedError
            The calibration fails its gates: nothing was flashed; the page says why.
        """
        need_estimators(self.board)
        start = time.monotonic()
        with self._step("colours"):
            first = self._first()
        with self._step("judged before"):
            before = self._judge(first, "before")
        with self._step("collect"):
            log, _ = self._collect("grid", self.counts.grid, self.seed + 1, first, "grid")
        with self._step("fit and report"):
            file, gates = self._fit(log, first)
        bad = failed(gates)
        if bad and not self.force:
            raise RefusedError(
                f"the calibration fails its gates ({'; '.join(f'{g.name}: {g.text}' for g in bad)}) and was not "
                f"flashed: see {self.folder / 'report.html'}, or give --force"
            )
        self._forget("after")
        with self._step("judged after"):
            after = self._judge(file, "after")
        return {
            "board": self.board.name, "simulated": self.site.is_simulated, "folder": str(self.folder),
            "presses": self.counts._asdict(), "seconds": self.seconds, "total_s": time.monotonic() - start,
            "sha256": file.sha256.hex(), "passed": not bad, "before": before, "after": after,
            "gates": [gate._asdict() for gate in gates],
        }  # fmt: skip

    @contextlib.contextmanager
    def _step(self, name: str) -> Iterator[None]:
        start = time.monotonic()
        yield
        self.seconds[name] = time.monotonic() - start
        self.say(f"{name}: {self.seconds[name]:.0f} s")

    def _forget(self, name: str) -> None:
        shutil.rmtree(self.folder / f"{name}.h5.parts", ignore_errors=True)
        for file in (f"{name}.h5", f"{name}_truth.npy"):
            (self.folder / file).unlink(missing_ok=True)

    def _first(self) -> CalibrationFile:
        """Colours by ball presses, and the operator of the board's own numbers."""
        done = self.folder / "before.safetensors"
        if done.exists():
            return container.read(done)
        noise = Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(self.board), tilt_m=TILT_M)
        kind = make_operator(self.board, method="support", noise=noise)
        metadata = {**container.base_metadata(self.board), **kind.metadata}
        path, _ = self._collect("balls", self.counts.balls, self.seed, container.pack(kind.tensors, metadata), "balls")
        job = Job(self.board, [path])
        self._tell("photometric", photometric.STAGE.run(job, lambda _: None))
        file = container.pack({**kind.tensors, **job.tensors}, {**metadata, **job.metadata})
        container.write(done, file)
        return file

    def _fit(self, path: Path, first: CalibrationFile) -> tuple[CalibrationFile, list[Any]]:
        job = Job(self.board, [path], parts=[first], n_error_touches=self.counts.error_touches)
        outcomes = run_stages(job, frozenset(), tell=lambda name, outcome, _: self._tell(name, outcome))
        file, gates = finished(job, outcomes)
        container.write(self.folder / "calibration.safetensors", file)
        report = report_of(self.board, file, job.log())
        write_page(self.folder / "report.html", self.board, file, report)
        return file, gates

    def _tell(self, name: str, outcome: Outcome) -> None:
        self.say(f"{name}: {outcome.state}, {outcome.text}")

    def _collect(
        self, program: str, n: int, seed: int, calibration: CalibrationFile, name: str
    ) -> tuple[Path, Truth | None]:
        path = self.folder / f"{name}.h5"
        facts = {
            "board": self.board.name, "program": program, "seed": seed, "n": n, "tip": self.site.tip,
            "rig": "sim" if self.site.is_simulated else "bench",
        }  # fmt: skip
        if path.exists():
            self.say(f"{name}: {path} is there")
            return path, None
        with self.site.open(program, calibration) as (bench, truth):
            span = self.site.span
            if name == "grid":  # inside, where a dent does not reach the rim that the depth is gauged by
                span = span._replace(half_x_m=FITTED_PART * span.half_x_m, half_y_m=FITTED_PART * span.half_y_m)
            touches = plan(program, span, n, seed) if name in FITTED else judged_touches(span, n, seed)
            collect(bench, touches, LogWriter(path, facts),
                    tell=lambda p: self.say(f"{name} {p.n_done}/{p.n_total} {p.text}"))  # fmt: skip
        return path, truth

    def _judge(self, file: CalibrationFile, name: str) -> dict[str, Any]:
        """The same touches each time, of a seed that nothing is fitted to."""
        seed = self.seed + 1000
        known = self.folder / f"{name}_truth.npy"
        if self.site.is_simulated and not known.exists():  # the truth of what was not finished is lost
            self._forget(name)
        path, truth = self._collect("grid", self.counts.judged, seed, file, name)
        log = read_log(path)
        if truth is not None:
            write_array(known, np.array([truth.of(t) for t in log.touches]))
        is_known = known.exists()
        true = np.asarray(read_array(known), float) if is_known else np.array([_reference(log, t) for t in log.touches])
        said = np.array([
            t.arrays["stream_wrench"][is_settled(t.arrays["stream_host_s"], t.facts)].mean(axis=0)
            for t in log.touches
        ])  # fmt: skip
        error = np.linalg.norm((said - true)[:, :3], axis=1)
        largest = float(np.linalg.norm(true[:, :3], axis=1).max())
        self.say(f"{name}: force off by {1e3 * np.sqrt(np.mean(error**2)):.1f} mN RMS of up to {largest:.2f} N")
        return {
            "touches": len(error), "force_rmse_n": float(np.sqrt(np.mean(error**2))),
            "force_p95_n": float(np.percentile(error, 95)), "force_worst_n": float(error.max()),
            "axes_rmse_n_nm": np.sqrt(np.mean((said - true) ** 2, axis=0)).tolist(), "largest_force_n": largest,
            "against": "the twin's truth" if is_known else "the reference",
        }  # fmt: skip


def need_estimators(board: Board) -> None:
    """Raises InputError where the board has no estimator that can be fitted here."""
    if not {"operator", "photometric"} <= set(board.pipeline.stages):
        raise InputError(f"board {board.name!r} has no estimator that `cal auto` fits yet: its pipeline is "
                         f"{', '.join(board.pipeline.stages)}")  # fmt: skip


def judged_touches(span: Span, n: int, seed: int) -> list[Touch]:
    """Places and depths that no program of a fit has, two of three sheared."""
    rng = np.random.default_rng(seed)
    touches = []
    for i in range(n):
        x, y = rng.uniform(-1, 1, 2) * (span.half_x_m, span.half_y_m)
        depth, angle = rng.uniform(0.4, 1.0) * span.deepest_m, rng.uniform(0, 2 * np.pi)
        way = 0.0 if i % 3 == 0 else rng.uniform(0.3, 1.0) * span.shear_m
        touches.append(Touch(float(x), float(y), float(depth), float(way * np.cos(angle)), float(way * np.sin(angle))))
    return touches


def _reference(log: Log, touch: TouchRecord) -> Array:
    settled = is_settled(touch.arrays["reference_s"], touch.facts)
    return np.asarray(reference_in_pad(log, touch)[settled].mean(axis=0))
