"""Machines that run GRBL 1.1: lines answered with ok or error, realtime characters for state, hold and reset."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence

from ruffini.errors import NoDeviceError, RefusedError
from ruffini.rig.gcode_line import ANSWER_S, HOME_S, TURN_S, GcodeMachine
from ruffini.rig.stage import Guard, Place, check_turned, moves, no_guard, turning

START_S, REPORT_S, HOLD_S = 3.0, 0.02, 2.0
HALT_ANSWER_S = 15.0  # whatever the patience: a bench that does not halt is told at once
ARRIVED_M = 5e-6
REPORT = re.compile(r"<(\w+(?::\d+)?)\|MPos:(-?[\d.]+(?:,-?[\d.]+){2,})")
AXES = "XYZABCUVW"  # in the order of MPos
ALARMS = {
    "1": "a limit switch was hit and steps were lost",
    "2": "the move leads out of its own soft limits",
    "3": "it was reset while it moved and steps were lost",
    "6": "it was reset while it homed",
    "8": "a limit switch did not open while it homed",
    "9": "no limit switch was found while it homed",
}
ERRORS = {"9": "it is locked by an alarm", "15": "the jog leads out of its own soft limits", "22": "no speed was given"}


class Grbl(GcodeMachine):
    """A machine that runs it."""

    firmware = "GRBL"
    _aside_m = 0.0  # of the machine's own x axis from its place above a tube
    _axes: Sequence[float] = ()  # as reported last, mm and degrees

    def _greet(self) -> None:
        self._reset()

    def _reset(self) -> None:
        """Empty its buffer; where it stands still its position stays known."""
        self._line.send(b"\x18")
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline:
            line = self._line.next_line()
            if line is not None and line.startswith("Grbl"):
                self._line.drain(0.05)
                return
        raise NoDeviceError(f"{self.name} does not answer a reset: is it switched on, and does it run GRBL?")

    def home(self) -> None:
        self._command("$H", HOME_S)
        for text in ("G21", "G90"):
            self._command(text, ANSWER_S)
        self._is_homed = True

    def position(self) -> Place:
        return self._report()[1]

    def move(self, place: Place, speed_m_s: float, guard: Guard = no_guard) -> None:
        self._need_homed()
        distance = self.position().distance(place) + self._aside_m
        with self._halting():
            for words in moves(place, speed_m_s, self._rotary):
                self._command(f"G53 G1 {words}", ANSWER_S, guard)
            here = self._arrive(f"{place}", ANSWER_S + 2 * distance / speed_m_s, guard)
            if here.distance(place) > ARRIVED_M:
                raise NoDeviceError(f"{self.name} stands at {here}, not at {place}: a move was lost: home it again")

    def turn(self, degrees: Mapping[str, float], guard: Guard = no_guard) -> None:
        with self._halting():
            words = turning(degrees)
            self._command(f"G53 G1 {words}", TURN_S, guard)
            self._arrive(words, TURN_S, guard)
        check_turned(self.name, degrees, dict(zip(AXES, self._axes, strict=False)))

    def _arrive(self, there: str, timeout_s: float, guard: Guard) -> Place:
        """Where it stands after a move to `there`."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            guard()
            state, here = self._report()
            if state == "Idle":
                return here
            if state not in ("Run", "Jog"):
                raise RefusedError(
                    f"{self.name} went into state {state} on the way to {there}: clear it at the machine"
                )
            time.sleep(REPORT_S / 2)
        raise NoDeviceError(f"{self.name} does not arrive at {there} within {timeout_s:.0f} s: is it blocked?")

    def halt(self) -> None:
        self._line.send(b"!")
        deadline = time.monotonic() + HOLD_S
        while time.monotonic() < deadline:
            state, _ = self._report(HALT_ANSWER_S)
            if state in ("Hold:0", "Idle"):
                self._reset()  # what was left of the move is forgotten
                for text in ("G21", "G90"):
                    self._command(text, ANSWER_S)
                return
        raise NoDeviceError(f"{self.name} does not hold within {HOLD_S:g} s: switch it off")

    def raise_by(self, height_m: float, speed_m_s: float) -> None:
        self._reset()
        self._command("$X", ANSWER_S)  # an alarm locks it; its position is not trusted until it was homed
        self._command(f"$J=G91 G21 Z{1e3 * height_m:.4f} F{60e3 * speed_m_s:.1f}", ANSWER_S)
        deadline = time.monotonic() + ANSWER_S + 2 * height_m / speed_m_s
        while self._report()[0] != "Idle":
            if time.monotonic() > deadline:
                raise NoDeviceError(f"{self.name} does not come up: is it blocked?")
            time.sleep(REPORT_S)

    def _report(self, timeout_s: float = ANSWER_S) -> tuple[str, Place]:
        self._line.send(b"?")
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            line = self._line.next_line()
            if line is None:
                continue
            match = REPORT.match(line)
            if match:
                return match[1], self._place([float(v) for v in match[2].split(",")])
            self._check(line)
        raise NoDeviceError(f"{self.name} does not report its state for {timeout_s:g} s: is it plugged in?")

    def _place(self, axes: list[float]) -> Place:
        self._axes = axes
        x_m, y_m, z_m = (1e-3 * v for v in axes[:3])
        if self._rotary is None:
            return Place(x_m, y_m, z_m)
        i = AXES.index(self._rotary.letter)
        if i >= len(axes):
            raise NoDeviceError(
                f"{self.name} reports {len(axes)} axes, none of them {self._rotary.letter}: check [stage] rotary_axis"
            )
        self._aside_m = abs(x_m - self._rotary.x_m)
        return Place(self._rotary.way_m(axes[i]), y_m, z_m)

    def _command(self, text: str, timeout_s: float, guard: Guard = no_guard) -> None:
        self._line.send(text.encode() + b"\n")
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            guard()
            line = self._line.next_line()
            if line == "ok":
                return
            if line is not None:
                self._check(line)
        raise NoDeviceError(f"{self.name} does not answer {text!r} for {timeout_s:g} s: is it plugged in?")

    def _check(self, line: str) -> None:
        kind, _, code = line.partition(":")
        if kind == "ALARM":
            self._is_homed = False
            why = ALARMS.get(code, "see its manual")
            raise RefusedError(f"{self.name} raised alarm {code} ({why}): clear the way, then home it again")
        if kind == "error":
            raise RefusedError(f"{self.name} refuses with error {code} ({ERRORS.get(code, 'see its manual')}): home it")
        if line.startswith("Grbl"):
            self._is_homed = False
            raise NoDeviceError(
                f"{self.name} was reset: it does not know where it is any more: lift the tip, home again"
            )
