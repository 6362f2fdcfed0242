"""The work of a calibration from the page: presses on a kitchen scale, fit, report, flash, undo.

Each calibration has a folder of its own, in which every press is a file before the next one begins: whatever ends the
work, the newest folder that was not flashed is continued. The steps are those of the verbs `cal collect`, `fit`,
`report`, `flash` and `undo`.
"""

from __future__ import annotations

import contextlib
import datetime
import itertools
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.calibrate.fit.job import Job, Outcome
from ruffini.calibrate.fit.run import finished, run_stages
from ruffini.calibrate.gates import REMEDIES, Gate, check_gates, failed
from ruffini.device import Connection, backup
from ruffini.device.connection import SILENCE_S
from ruffini.device.line import DEVICE
from ruffini.device.zeroing import learn_rest
from ruffini.errors import InputError, RefusedError, RuffiniError
from ruffini.estimators.table import needs_ball_first, reported_by, scale_span
from ruffini.files import readable, write_whole
from ruffini.live.folders import CALIBRATIONS, unit_folder
from ruffini.older_python import UTC
from ruffini.rig.bench import Bench
from ruffini.rig.collect import collect
from ruffini.rig.guide import Guide
from ruffini.rig.guide_view import HeardPerson, told
from ruffini.rig.hid_scale import find_scales
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.person import PageKeys, TerminalPerson
from ruffini.rig.placed_weight import grams_of
from ruffini.rig.program import SCALE, ByHand, HandTouch, ScalePress, check_weights, plan
from ruffini.rig.session import open_real, ready_bench
from ruffini.rig.settings import SCALE_MAX_N, scale_rig
from ruffini.rig.units import GRAVITY_M_S2
from ruffini.view.guided import press_keys
from ruffini.view.steps import CLOSE, OPEN, Choice, Field, GateRow, Step

Fields = Mapping[str, str]
Borrow = Callable[[], contextlib.AbstractContextManager[Connection]]

N_MORE = 6  # presses that are added if a gate fails
MAX_PRESSES = 200
BALL_MM = (1.0, 50.0)  # diameters that a person presses a pad with
SEED = 1
SETTINGS, FLASHED, BEFORE, FITTED = "settings.json", "flashed.txt", "before.safetensors", "calibration.safetensors"
PAGE, FIGURES = "report.html", "report.json"

BEGIN = Choice("begin", "Begin", "begin a new calibration")
GO_ON = Choice("continue", "Continue", "go on with the presses that are kept")
MORE = Choice("more", f"Press {N_MORE} more", "the worst presses again, and more places")
FLASH = Choice("flash", "Flash it", "put this calibration in force on the sensor")
NEW = OPEN._replace(label="New calibration", hint="leave these presses, and show the form of a new calibration")
UNDO = Choice("undo", "Undo", "put the calibration in force that was before; once more takes that back")
WHAT_IT_TAKES = (
    "Lay the sensor on a kitchen scale, pad up, and set the scale to zero. You press with something blunt, or with a "
    "ball of known diameter, hold, and type what the scale shows."
)
NEEDS_BALL = (
    "this sensor has no calibration that tells depth from colours: press with a ball and give its diameter in mm"
)
ONE_KIND = (
    "this gel has no markers: the forces are right for what you press with, and less so for what touches the gel in "
    "another way, as the stated uncertainty says"
)

OTHER = (
    "these presses were begun with another calibration in force than now: begin a new calibration, or put the former "
    "back with Undo, then continue"
)


class Plan(NamedTuple):
    """What a person presses, as it is kept in the calibration's folder. `rounds`: presses of each log, (x, y, g)."""

    ball_mm: float | None
    scale: str  # port; empty: the person types what it shows
    grams: tuple[float, ...]
    rounds: tuple[tuple[ScalePress, ...], ...]
    in_force: str  # SHA-256 of the calibration that the presses are measured with; empty: none

    def write(self, folder: Path) -> None:
        """Raises InputError if it cannot be written."""
        write_whole(folder / SETTINGS, json.dumps(self).encode())

    @classmethod
    def read(cls, folder: Path) -> Plan:
        """Raises InputError if the file is spoilt."""
        path = folder / SETTINGS
        try:
            ball_mm, scale, grams, rounds, in_force = json.loads(readable(path).read_text())
            planned = tuple(tuple(ScalePress(*p) for p in presses) for presses in rounds)
            return cls(ball_mm, scale, tuple(grams), planned, in_force)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"{path}: cannot be read ({error}): begin a new calibration") from error

    def logs(self, folder: Path) -> list[Path]:
        """One a round."""
        return [folder / f"presses-{i}.h5" for i in range(1, len(self.rounds) + 1)]

    def is_pressed(self, folder: Path) -> bool:
        """All planned presses are there, as logs."""
        return all(log.exists() for log in self.logs(folder))

    def n_done(self, folder: Path) -> int:
        """Presses that are kept."""
        parts = [folder / f"{log.name}.parts" for log in self.logs(folder)]
        return sum(
            len(presses) if log.exists() else len(list(part.glob("[0-9]*.h5")))
            for presses, log, part in zip(self.rounds, self.logs(folder), parts, strict=True)
        )

    @property
    def n_total(self) -> int:
        """Presses of all rounds."""
        return sum(map(len, self.rounds))


@dataclass
class ScaleCalibration:
    """All of it runs in one worker thread, but for `told`, `answer` and `stop`.

    Parameters
    ----------
    borrow : gives the sensor to the thread that asks, and takes it back.
    show : replaces what the page shows.
    progress : likewise, with a sentence and the part of the work that is done.
    root : folder of this unit's calibrations; None: below XDG_STATE_HOME, by board and serial number.
    n_error_touches : simulated touches behind the stated uncertainty.
    """

    borrow: Borrow
    show: Callable[[Step], None]
    progress: Callable[..., None]
    root: Path | None = None
    n_error_touches: int = 120
    current: Path | None = None  # folder of the calibration that is shown
    _guide: Guide = field(default_factory=Guide)
    _bench: Bench | None = None
    _keys: PageKeys = field(default_factory=PageKeys)
    _board: Board | None = None
    _serial: str = "*"
    _key_ids: tuple[str, ...] = ()  # of the sensor's owners
    _sha256: str = ""  # of the calibration in force; empty: none
    _is_stopped: bool = False

    # ---- for other threads ----------------------------------------------------------------------

    def told(self) -> dict[str, Any]:
        """The state of the press, as JSON takes it."""
        return told(self._guide, self._bench)

    @property
    def board_name(self) -> str:
        """Empty before the sensor was looked at."""
        return "" if self._board is None else self._board.name

    @property
    def page(self) -> Path | None:
        """The report as HTML, where it is or will be."""
        return None if self.current is None else self.current / PAGE

    def answer(self, word: str, number: int, typed: str) -> None:
        """To a question while a person presses."""
        self._is_stopped |= word == "stop"
        press_keys(self._keys, self._guide, word, number, typed)

    def stop(self) -> None:
        """End a press under way."""
        self._is_stopped = True
        self._keys.press(is_stop=True)

    # ---- the worker -----------------------------------------------------------------------------

    def run(self, word: str, fields: Fields) -> None:
        """Do what a person chose, and show the step after it.

        Raises
        ------
        RuffiniError, OSError
            It cannot be done; `after_failure` is what to show.
        """
        works: dict[str, Callable[[Fields], None]] = {
            "open": self._open, "begin": self._begin, "continue": self._go_on, "more": self._more,
            "flash": self._flash, "undo": self._undo,
        }  # fmt: skip
        works[word](fields)

    def after_failure(self, why: str) -> Step:
        """The presses that are kept, and how to go on with them."""
        choices = (GO_ON, MORE, NEW, CLOSE) if self._is_pressed() else (GO_ON, NEW, CLOSE)
        kept = f"{why} The presses are kept in {self.current}."
        return Step("ended", "It has ended", kept, is_bad=True, choices=choices)

    def _is_pressed(self) -> bool:
        """True if all planned presses are there."""
        with contextlib.suppress(RuffiniError):
            if self.current is not None:
                return Plan.read(self.current).is_pressed(self.current)
        return False

    def _open(self, _: Fields) -> None:
        """Look at the sensor; offer to begin, or to go on with what is kept."""
        with self.borrow() as sensor:
            self._look_at(sensor)
        assert self._board is not None
        scale_span(self._board)
        self.current = None
        folder = self._unfinished()
        needs_ball = not self._is_calibrated and needs_ball_first(self._board)
        # Colours that are learned from the same presses need more and deeper ones.
        grams, n = ("100, 150, 200", "30") if needs_ball else ("50, 100, 150, 200", "20")
        fields = (
            Field("grams", "Weights to press", grams, "g"),
            Field("presses", "Presses", n, ""),
            Field("ball", "Diameter of the ball, if you press with one", "", "mm"),
            Field("scale", "Port of the scale, if it has one that prints grams", "".join(find_scales()[:1]), ""),
        )
        text = WHAT_IT_TAKES
        if needs_ball:
            text += f" Note: {NEEDS_BALL}."
        if self._board.picture_features is not None:
            text += f" Note: {ONE_KIND}."
        if self._key_ids:
            text += f' Note: {self._owners_way("FILE")}; at the end the button "Flash it" shows the whole command.'
        choices: tuple[Choice, ...] = (BEGIN, UNDO, CLOSE) if self._is_calibrated else (BEGIN, CLOSE)
        is_bad = False
        if folder is not None:
            try:
                kept = Plan.read(folder)
                is_bad = not kept.is_pressed(folder) and self._is_other(kept)
                choices = (BEGIN, UNDO, CLOSE) if is_bad else (GO_ON, *choices)
                why = f" {OTHER[0].upper()}{OTHER[1:]}." if is_bad else ""
                text = f"{kept.n_done(folder)} of {kept.n_total} presses are kept in {folder}.{why} {text}"
            except InputError as error:
                text, is_bad = f"{error}. {text}", True
        self.show(Step("offer", "Calibrate with a kitchen scale", text, is_bad, choices, fields))

    def _look_at(self, sensor: Connection) -> None:
        described = sensor.hello.sensors[0]
        self._board = parse_board(described.board_toml, sensor.port)
        self._serial = sensor.serial_number
        self._key_ids = tuple(getattr(sensor.hello, "key_ids", ()))  # an older sensor's says nothing of them
        self._sha256 = described.calibration.sha256.hex() if described.calibration.present else ""

    def _owners_way(self, file: str) -> str:
        """How a calibration comes in force on a sensor with owners."""
        return (
            f"this sensor has owners (keys {', '.join(self._key_ids)}), and a page signs with no key of theirs: "
            f"to put the calibration in force, end the viewer, then `ruffini cal flash {file} --key NAME`"
        )

    @property
    def _is_calibrated(self) -> bool:
        return bool(self._sha256)

    def _is_other(self, kept: Plan) -> bool:
        """Another calibration is in force than the presses were measured with: a fit of both would be of neither."""
        return kept.in_force != self._sha256

    def _in_force(self, sensor: Connection) -> bytes:
        return sensor.read_calibration(lambda part: self.progress("Reading the calibration in force", part))

    def _root(self) -> Path:
        assert self._board is not None
        return self.root or unit_folder(CALIBRATIONS, self._board.name, self._serial)

    def _unfinished(self) -> Path | None:
        """The newest calibration, if it was not flashed."""
        found = sorted(path.parent for path in self._root().glob(f"*/{SETTINGS}"))
        return found[-1] if found and not (found[-1] / FLASHED).exists() else None

    def _begin(self, fields: Fields) -> None:
        """A new calibration as the form was filled in."""
        assert self._board is not None
        grams, n, ball_mm = asked_for(fields)
        scale = fields.get("scale", "").strip()
        if scale and not scale.startswith("/dev/"):
            raise InputError(
                f"scale: {scale!r} is no port: give one such as /dev/ttyUSB0, or nothing, and type the weights"
            )
        if ball_mm is None and not self._is_calibrated and needs_ball_first(self._board):
            raise InputError(NEEDS_BALL)
        presses = self._planned(n, grams)
        check_weights(presses, SCALE_MAX_N)
        if scale:  # one that cannot be opened is told while the form is there
            scale_rig(scale).reference.open().close()
        now = datetime.datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
        folder = self._root() / now
        Plan(ball_mm, scale, grams, (tuple(presses),), self._sha256).write(folder)
        self.current = folder
        self._press_and_fit(folder)

    def _planned(self, n: int, grams: tuple[float, ...]) -> list[ScalePress]:
        """The first n presses of a sequence that has no end."""
        assert self._board is not None
        items = plan(SCALE, scale_span(self._board), n, SEED, ByHand(grams))
        return [item for item in items if isinstance(item, ScalePress)]

    def _go_on(self, _: Fields) -> None:
        """The presses that are missing, then the fit."""
        self.current = self.current or self._unfinished()
        if self.current is None:
            raise InputError("the presses are gone: begin a new calibration")
        self._press_and_fit(self.current)

    def _more(self, _: Fields) -> None:
        """The worst presses again, then places that were not pressed yet."""
        folder = self.current
        assert folder is not None
        before = Plan.read(folder)
        again = _worst_of(folder / FIGURES)
        n_new = len({press for presses in before.rounds for press in presses})
        new = self._planned(n_new + N_MORE - len(again), before.grams)[n_new:]
        before._replace(rounds=(*before.rounds, (*again, *new))).write(folder)
        self._press_and_fit(folder)

    def _press_and_fit(self, folder: Path) -> None:
        kept = Plan.read(folder)
        if not kept.is_pressed(folder):
            with self.borrow() as sensor:
                self._look_at(sensor)
                if self._is_other(kept):
                    raise RefusedError(OTHER)
                self._press(sensor, folder, kept)
        self._fit(folder, kept)

    def _press(self, sensor: Connection, folder: Path, kept: Plan) -> None:
        """Learn rest, then every press that is missing."""
        assert self._board is not None
        board, path = self._board, folder / BEFORE
        if self._is_calibrated and not path.exists():
            write_whole(path, self._in_force(sensor))
        self._guide, self._bench = Guide(), None
        with contextlib.suppress(RefusedError):
            self._keys.guard()  # pressed while nobody asked
        hands = TerminalPerson(lambda _: None, self._keys.descriptor, watch=lambda: self._watch(sensor))
        person = HeardPerson(hands, self._guide, self._keys.guard)
        self._is_stopped = False
        self.show(Step("press"))
        try:
            person.confirm("set the scale to zero, and take everything off the pad")
            person.say("wait: the untouched pad is learned")
            learn_rest(sensor)
            frames = (frame for frame, _ in sensor.stream(timeout_s=SILENCE_S) if frame.sensor != DEVICE)
            is_simulated = any(frame.is_simulated for frame in itertools.islice(frames, 1))
            with contextlib.ExitStack() as stack:
                parts = open_real(stack, scale_rig(kept.scale), board, sensor, person)
                bench = stack.enter_context(ready_bench(parts, board, None, self._keys.guard))
                bench.guide, self._bench = self._guide, bench
                tip = None if kept.ball_mm is None else {"shape": "sphere", "radius_m": kept.ball_mm / 2e3}
                for number, (log, presses) in enumerate(zip(kept.logs(folder), kept.rounds, strict=True)):
                    if not log.exists():
                        facts = {"board": board.name, "program": SCALE, "seed": SEED, "round": number,
                                 "n": len(presses), "rig": "scale", "tip": tip, "simulated": is_simulated}  # fmt: skip
                        items = [_by_force(press) for press in presses] if kept.scale else presses
                        collect(bench, items, LogWriter(log, facts))
        except RefusedError as error:
            if not self._is_stopped:
                raise
            raise RefusedError("stopped from the page: what was collected is kept") from error
        finally:
            self._bench = None

    def _watch(self, sensor: Connection) -> None:
        """While a person is asked; raises NoDeviceError if the sensor is lost or, on a bench, its camera stalls."""
        if self._bench is not None:
            self._bench.stream.latest()
        else:
            sensor.status()
            sensor.messages.clear()  # frames of before the answer: rest is learned from those after it

    def _fit(self, folder: Path, kept: Plan) -> None:
        """Fit, judge, and show the report."""
        assert self._board is not None
        board, logs = self._board, kept.logs(folder)
        before = container.read(folder / BEFORE) if (folder / BEFORE).exists() else None
        is_simulated = any(read_log(log).facts.get("simulated") for log in logs)
        # The twin's pad is linear, a real gel is not.
        job = Job(board, logs, before, n_error_touches=self.n_error_touches, is_finite=not is_simulated)
        self.progress("Fitting", 0.0)

        def tell(name: str, outcome: Outcome, _: float) -> None:
            self.progress(f"Fitting: {name} {outcome.state}")

        outcomes = run_stages(
            job, frozenset(), tell=tell, progress=lambda name, part: self.progress(f"Fitting: {name}", part)
        )
        file, _ = finished(job, outcomes, self._serial)
        container.write(folder / FITTED, file)
        made = reported_by(file).report(
            board, file, logs, previous=before, progress=lambda part: self.progress("Judging", part)
        )
        made.write_page(folder / PAGE)
        write_whole(folder / FIGURES, json.dumps(made.tree, indent=1).encode())
        self._show_report(made.text, made.gates, made.tree)

    def _show_report(self, text: str, gates: list[Gate], tree: dict[str, Any]) -> None:
        bad = failed(gates)
        left = tree.get("left_out")
        if left:
            text += (f"; presses left out of the fit: {1e3 * left['force_rmse_n']:.0f} mN RMS, 95 % within "
                     f"{1e3 * left['force_p95_n']:.0f} mN, up to {left['largest_force_n']:.2f} N")  # fmt: skip
        if bad:
            worst = "; ".join(f"{1e3 * w['error_n']:.0f} mN off: {w['told']}" for w in tree.get("worst", []))
            text += f". To be pressed again: {worst}" if worst else ""
        said = f"Not good enough: {', '.join(g.name for g in bad)}" if bad else "Passes its gates"
        choices = (MORE, CLOSE) if bad else (FLASH, MORE, CLOSE)
        self.show(Step("report", said, f"{text[:1].upper()}{text[1:]}.", is_bad=bool(bad), choices=choices,
                        gates=tuple(_row(g) for g in gates if g.ok is not None), has_report=True))  # fmt: skip

    def _flash(self, _: Fields) -> None:
        """Put the fitted file in force; what was in force is also kept on this computer."""
        folder = self.current
        assert folder is not None
        file = container.read(folder / FITTED)
        check_gates(file, force=False)
        with self.borrow() as sensor:
            self._look_at(sensor)
            assert self._board is not None
            container.check_board(file, self._board)
            if self._is_calibrated:
                backup.keep(self._in_force(sensor), sensor.serial_number, backup.folder())
            try:
                sensor.flash(file.data, lambda part: self.progress("Flashing", part), self.progress)
            except RefusedError as error:
                if not self._key_ids:
                    raise
                raise RefusedError(f"{error}; {self._owners_way(str(folder / FITTED))}") from error
        write_whole(folder / FLASHED, file.sha256.hex().encode())
        text = "The sensor measures with this calibration now, and keeps the one before: Undo puts that back."
        self.show(Step("flashed", "In force", text, choices=(CLOSE, UNDO), has_report=True))

    def _undo(self, _: Fields) -> None:
        """Put the calibration before in force."""
        with self.borrow() as sensor:
            sensor.undo_flash()
            active = sensor.hello.sensors[0].calibration
        what = f"{', '.join(active.kinds)} of {active.created_utc}" if active.present else "no calibration, as before"
        self.show(Step("flashed", "Undone", f"In force: {what}. Undo once more takes that back.",
                        choices=(CLOSE, UNDO)))  # fmt: skip


def _worst_of(report: Path) -> list[ScalePress]:
    """The presses that a report names; none before there is one."""
    if not report.exists():
        return []
    try:
        worst = json.loads(readable(report).read_text()).get("worst", [])  # only reports of a pad name places
        return [ScalePress(float(w["x_m"]), float(w["y_m"]), float(w["grams"])) for w in worst]
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{report}: cannot be read ({error!r}): Continue makes it again") from error


def _by_force(press: ScalePress) -> HandTouch:
    """The same for a scale that is read without a person."""
    return HandTouch(press.x_m, press.y_m, 1e-3 * press.grams * GRAVITY_M_S2)


def _row(gate: Gate) -> GateRow:
    return GateRow(gate.name, gate.ok, gate.text, REMEDIES.get(gate.name, "") if gate.ok is False else "")


def asked_for(fields: Fields) -> tuple[tuple[float, ...], int, float | None]:
    """Weights in grams, number of presses, and the ball's diameter in mm, as a person fills them in.

    White space, `;`, and a comma before white space separate weights. A comma between digits is a decimal comma where
    something else separates, and separates where nothing else does: "20,5, 10" is 20.5 and 10, but "12,25" is 12 and
    25, and "20,5" is 20 and 5. Before three digits it always separates. Each weight may end in g.

    Raises
    ------
    InputError
        One of them makes no sense; the text names it.
    """
    typed = re.sub(r"(?<=\d)\s*g(?![^;,\s])", "", fields.get("grams", "")).strip().rstrip(",; ")
    typed = re.sub(r",(?=\d{3}(?!\d))", "; ", typed)
    pieces = re.split(r"\s*[;\s],?\s*|,\s+", typed)
    pieces = [piece for piece in (pieces if len(pieces) > 1 else typed.split(",")) if piece]
    if not pieces:
        raise InputError("weights: give one at least, such as 50, 100, 200")
    grams = tuple(grams_of(piece) for piece in pieces)
    n_text, ball_text = fields.get("presses", "").strip(), fields.get("ball", "").strip()
    if not re.fullmatch(r"[0-9]{1,3}", n_text) or not 1 <= int(n_text) <= MAX_PRESSES:
        raise InputError(f"presses: {n_text!r} is no number of presses: give 1 to {MAX_PRESSES}")
    if not ball_text:
        return grams, int(n_text), None
    found = re.fullmatch(r"(\d{1,3}(?:[.,]\d{1,3})?)\s*(?:mm)?", ball_text, re.ASCII)
    ball_mm = float(found[1].replace(",", ".")) if found else 0.0
    if not BALL_MM[0] <= ball_mm <= BALL_MM[1]:
        raise InputError(f"ball: {ball_text!r} is no diameter of a ball: give {BALL_MM[0]:g} to {BALL_MM[1]:g} mm")
    return grams, int(n_text), ball_mm
