"""`ruffini cal auto` for a fingertip with pins, on its twin: presses of several tools at many places and angles.

1. the presses of the board's presses.toml are made: part "fit" is fitted, part "judge" (other tools, sizes, places,
   angles, seeds) is never fitted
2. `cal fit --only fingertip`, and a page that says how presses left out of the fit are told
3. flashed to a real daemon where its gates pass
4. every judged press is played through that daemon; what comes over its line is held against the twin's truth

On a bench a person turns the fingertip: `ruffini.calibrate.auto.run`. What was made is kept: the same command goes on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.auto.steps import Steps
from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.fit.job import Job
from ruffini.calibrate.fit.run import finished, run_stages
from ruffini.calibrate.gates import Gate, failed, need_passed
from ruffini.calibrate.report.html import Page
from ruffini.calibrate.report.page import gate_table
from ruffini.daemon import running_daemon
from ruffini.device import Connection, Contacts
from ruffini.device.results import Contact
from ruffini.errors import InputError
from ruffini.estimators.fingertip.presses import AREA, axes
from ruffini.estimators.fingertip.report import NAMES, figures_of, is_judged
from ruffini.estimators.task import Turned
from ruffini.files import write_whole
from ruffini.sim.reproduce.make import reproduce
from ruffini.sim.reproduce.runs import Run, runs_of
from ruffini.sim.reproduce.settings import load_reproduce
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]

N_EYES = 2
FRAME_S = 5.0  # longest wait for a frame of the line


@dataclass
class TipAuto:
    """One run; `folder` keeps presses, calibration, pages and the result."""

    board: Board
    task: Turned
    folder: Path
    baseline_mm: float
    say: Callable[[str], None]
    is_quick: bool = False
    force: bool = False
    previous: CalibrationFile | None = None

    def __post_init__(self) -> None:
        self._step = Steps(self.folder, self.say, goes_on=False)

    def run(self) -> dict[str, Any]:
        """All steps; what `--json` prints.

        Raises
        ------
        InputError
            The board has no twin, or too few presses had a solution.
        RefusedError
            The calibration fails its gates; the page says why.
        """
        presses = self.folder / "presses"
        with self._step("collect"):
            reproduce(
                self.board, presses, bench=self.task.presses, quick=self.is_quick, progress=tenths("presses", self.say)
            )
        every = runs_of(load_reproduce(self.board, self.task.presses), quick=self.is_quick)
        judged = [r for r in every if r.settings.part == "judge" and (presses / r.key / "run.json").is_file()]
        if not judged:
            raise InputError(f"{presses}: no press of part 'judge' was made, so nothing could be judged")
        with self._step("judged before"):
            before = None if self.previous is None else self._judge(self.previous, presses, judged, "before")
        with self._step("fit and report"):
            job = Job(self.board, [presses], self.previous, baseline_mm=self.baseline_mm, pattern="fit*")
            outcomes = run_stages(job, frozenset(), tell=lambda *_: None, progress=self._fitting())
            fitted = outcomes[self.task.name].report
            file, gates = finished(job, outcomes, more=[] if before is None else [than_before(fitted, before)])
            container.write(self.folder / "calibration.safetensors", file)
            self._page("report.html", "How presses left out of the fit are told", None, gates, fitted)
        is_passed = need_passed(gates, self.folder / "report.html", force=self.force)
        with self._step("judged after"):
            after = self._judge(file, presses, judged, "after")
        result = {
            "board": self.board.name, "quick": self.is_quick, "task": self.task.name, "unit": self.task.unit,
            "simulated": True, "folder": str(self.folder), "seconds": self._step.seconds, "sha256": file.sha256.hex(),
            "presses": {"balls": 0, "fitted": int(fitted["n_presses"]), "judged": len(judged)},
            "passed": is_passed, "before": before, "after": after, "clock": None,
            "gates": [gate._asdict() for gate in gates],
        }  # fmt: skip
        write_whole(self.folder / "result.json", json.dumps(result, indent=1).encode() + b"\n")
        self._page("auto.html", f"off by {after['error']:.3g} {result['unit']}", after, gates, fitted)
        return result

    def _fitting(self) -> Callable[[str, float], None]:
        tell = tenths("fit", self.say)
        return lambda name, done: tell(done) if name == self.task.name else None

    def _judge(self, file: CalibrationFile, presses: Path, judged: list[Run], name: str) -> dict[str, Any]:
        """Flashed over a line, then each press over a line; against the twin's truth."""
        assert self.board.folder is not None
        store = self.folder / f"store-{name}"
        with (
            running_daemon(self.board.folder, f"replay:{presses / judged[0].key}", store, "--loop") as port,
            Connection(port) as sensor,
        ):
            sensor.flash(file.data)
        tell, rows = tenths(f"played {name}", self.say), []
        for n_done, run in enumerate(judged, 1):
            rows.append(self._played(presses / run.key, store))
            tell(n_done / len(judged))
        said, true = (np.concatenate(part) for part in zip(*rows, strict=True))
        figures = figures_of(said, true, len(judged))
        self.say(f"{name}: off by {figures['error']:.3g} mN, up to {figures['largest_force_n']:.2f} N")
        return figures

    def _played(self, recording: Path, store: Path) -> tuple[Array, Array]:
        """What the line and the twin say of the touched frames of a press, (t, 7) each; NaN where nothing is told."""
        assert self.board.folder is not None
        with np.load(recording / "truth.npz", allow_pickle=False) as kept:
            true = truth_of(kept["pose"], kept["wrench"])
        said, options = np.full_like(true, np.nan), ("--lockstep", "--wait-for-host", "--linger")
        with (
            running_daemon(self.board.folder, f"replay:{recording}", store, *options) as port,
            Connection(port) as sensor,
        ):
            sensor.subscribe(contacts=1)
            for frame, message in sensor.stream(timeout_s=FRAME_S):
                if sensor.schema.type_name(frame.type) != "CONTACTS":
                    continue
                sent = Contacts.from_message(message)
                if sent.frame >= len(said):
                    continue
                if sent.contacts:
                    said[sent.frame] = row_of(sent.contacts[0])
                if sent.frame == len(said) - 1:
                    break
        keep = is_judged(self.board, true)
        return said[keep], true[keep]

    def _page(
        self, name: str, verdict: str, figures: dict[str, Any] | None, gates: list[Gate], report: dict[str, Any]
    ) -> None:
        page = Page(f"cal auto: {self.board.name}, SIMULATED")
        page.verdict(verdict, is_good=not failed(gates))
        if figures is not None:
            page.heading("Judged presses: tools, sizes, places and angles of no fit; means of absolute errors")
            page.table(("frames", "told", *NAMES), [
                (figures["frames"], figures["told"], *(figures["mean"][q] for q in NAMES))
            ])  # fmt: skip
            page.link("report.html", "How presses left out of the fit are told")
        page.heading("Presses left out of the fit")
        left = report["mean_error_of_presses_left_out"]
        page.table(("eyes", *NAMES), [(eye, *(row[q] for q in NAMES)) for eye, row in left.items()])
        gate_table(page, gates)
        page.write(self.folder / name)


def tenths(
    what: str, say: Callable[[str], None], now_s: Callable[[], float] = time.monotonic
) -> Callable[[float], None]:
    """Of the part that is done: says each tenth, and the time that is left at the pace since it first was told one."""
    told, first, first_s = -1, 0.0, 0.0

    def tell(done: float) -> None:
        nonlocal told, first, first_s
        was, told = told, max(told, int(10 * done))
        if was < 0:
            first, first_s = done, now_s()  # what is kept from a run before took no time
            say(f"{what}: {100 * done:.0f} %")
        elif told > was:
            say(f"{what}: {100 * done:.0f} %; {(now_s() - first_s) * (1 - done) / (done - first):.0f} s to go")

    return tell


def than_before(report: dict[str, Any], before: dict[str, Any]) -> Gate:
    """A unit never gets worse: presses left out of the fit against what was in force, on the judged ones."""
    now, was = 1e3 * report["mean_error_of_presses_left_out"]["both"]["force_n"], before["error"]
    if np.isnan(was):
        return Gate(
            "than before", None, now, None, f"presses left out err by {now:.3g}, what was in force told nothing"
        )
    text = f"presses left out err by {now:.3g}, with what was in force judged ones by {was:.3g} mN mean of force"
    return Gate("than before", bool(now < was), now, was, text)


def eyes_apart_mm(board: Board) -> float:
    """Of a board's twin. Raises InputError where it has no two eyes."""
    views = load_twin(board).view
    if len(views) != N_EYES:
        raise InputError(f"board {board.name!r}: its twin.toml has {len(views)} views, a fingertip has two eyes")
    return 1e-3 * abs(views[1].offset_um[0] - views[0].offset_um[0])


def truth_of(pose: Array, wrench: Array) -> Array:
    """Force along the tool N, way, x, y mm, roll, pitch degrees, (t, 7); NaN where nothing touches, and of the area."""
    out = np.full((len(pose), 7), np.nan)
    for i in np.flatnonzero(np.isfinite(pose[:, 0])):
        x, y, depth, _, roll, pitch = pose[i]
        force = -float(wrench[i, :3] @ axes(roll, pitch)[:, 2])
        out[i, :AREA] = [force, 1e3 * depth, 1e3 * x, 1e3 * y, np.rad2deg(roll), np.rad2deg(pitch)]
    return out


def row_of(contact: Contact) -> Array:
    """The same of a contact of the line, whatever its validity; NaN if it has no tool."""
    tool = contact.raw_tool
    if tool is None:
        return np.full(7, np.nan)
    force = float(np.linalg.norm(tool.normal_force_n))
    x, y, way = (1e3 * v for v in (*tool.place_m, tool.way_m))
    return np.array([force, way, x, y, np.rad2deg(tool.roll_rad), np.rad2deg(tool.pitch_rad), 1e6 * contact.area])
