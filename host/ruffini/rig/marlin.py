"""Printers and machines that run Marlin: numbered lines with a checksum, each answered with ok."""

from __future__ import annotations

import functools
import re
import time
from collections.abc import Mapping

from ruffini.errors import NoDeviceError, RefusedError
from ruffini.rig.gcode_line import ANSWER_S, HOME_S, TURN_S, GcodeMachine
from ruffini.rig.stage import Guard, Place, Rotary, check_turned, moves, no_guard, turning

START_S, HALT_S = 5.0, 10.0
MAX_RESENDS = 5
POSITION = re.compile(r"X:(-?[\d.]+) Y:(-?[\d.]+) Z:(-?[\d.]+)")
TURNED = re.compile(r" ([ABCUVW]):(-?[\d.]+)")
RESEND = re.compile(r"(?:Resend|rs):?\s*N?(\d+)", re.IGNORECASE)


class Marlin(GcodeMachine):
    """A machine that runs it."""

    firmware = "Marlin"

    def _greet(self) -> None:
        self._line.drain(0.2)  # its greeting, where opening the port reset it
        self._begin()

    def _begin(self) -> None:
        self._number = -1
        self._command("M110 N0", START_S)
        self._command("G21", START_S)  # millimetres
        self._command("G90", START_S)  # absolute places

    def home(self) -> None:
        self._command("G28", HOME_S)
        self._is_homed = True

    def position(self) -> Place:
        for line in self._command("M114", ANSWER_S):
            match = POSITION.search(line)
            if match:
                x_m, y_m, z_m = (1e-3 * float(v) for v in match.groups())
                return Place(x_m if self._rotary is None else self._turned_m(line, self._rotary), y_m, z_m)
        raise NoDeviceError(f"{self.name} does not tell its position: is it Marlin?")

    def _turned_m(self, line: str, rotary: Rotary) -> float:
        turned = re.search(rf" {rotary.letter}:(-?[\d.]+)", line)
        if turned is None:
            raise NoDeviceError(f"{self.name} has no axis {rotary.letter} ({line}): check [stage] rotary_axis")
        return rotary.way_m(float(turned[1]))

    def move(self, place: Place, speed_m_s: float, guard: Guard = no_guard) -> None:
        self._need_homed()
        with self._halting():
            for words in moves(place, speed_m_s, self._rotary):
                self._command(f"G1 {words}", ANSWER_S, guard)
            self._command("M400", ANSWER_S, guard)  # answered when it stands

    def turn(self, degrees: Mapping[str, float], guard: Guard = no_guard) -> None:
        with self._halting():
            self._command(f"G1 {turning(degrees)}", TURN_S, guard)
            self._command("M400", TURN_S, guard)
        reported = TURNED.findall(" ".join(self._command("M114", ANSWER_S)))
        check_turned(self.name, degrees, {axis: float(angle) for axis, angle in reported})

    def halt(self) -> None:
        """At once with Marlin's EMERGENCY_PARSER, else at the end of the move: so moves near the pad are short."""
        self._line.send(b"M410\nM114\n")
        deadline, has_position = time.monotonic() + HALT_S, False
        while time.monotonic() < deadline:
            line = self._line.next_line()
            if line is None:
                continue
            has_position = has_position or POSITION.search(line) is not None
            if has_position and line.startswith("ok"):
                self._begin()
                return
        raise NoDeviceError(f"{self.name} does not halt within {HALT_S:g} s: switch it off")

    def raise_by(self, height_m: float, speed_m_s: float) -> None:
        self._line.drain(0.05)  # what it said about itself since
        self._begin()
        for text in ("G91", f"G1 Z{1e3 * height_m:.4f} F{60e3 * speed_m_s:.1f}", "M400", "G90"):
            self._command(text, ANSWER_S)

    def _command(self, text: str, timeout_s: float, guard: Guard = no_guard) -> list[str]:
        """Send one line and wait for its ok; lines that came before it."""
        self._number += 1
        packet = _numbered(self._number, text)
        self._line.send(packet)
        answers: list[str] = []
        n_resends, deadline = 0, time.monotonic() + timeout_s
        while True:
            guard()
            line = self._line.next_line()
            if line is None:
                if time.monotonic() > deadline:
                    raise NoDeviceError(f"{self.name} does not answer {text!r} for {timeout_s:g} s: "
                                        "is it switched on, and does it run Marlin at this baud rate?")  # fmt: skip
                continue
            self._check(line)
            if line.startswith("echo:busy"):
                deadline = time.monotonic() + timeout_s
            elif (wanted := RESEND.match(line)) is not None:
                n_resends += 1
                if n_resends > MAX_RESENDS or int(wanted[1]) != self._number:
                    raise NoDeviceError(f"{self.name} does not understand {text!r} after {n_resends} tries: "
                                        "check the cable")  # fmt: skip
                self._await_ok(deadline)
                self._line.send(packet)
            elif line == "ok" or line.startswith("ok "):
                return answers
            else:
                answers.append(line)

    def _await_ok(self, deadline: float) -> None:
        """A request to send again is followed by an ok that is no answer."""
        while time.monotonic() < deadline:
            line = self._line.next_line()
            if line is not None and line.startswith("ok"):
                return

    def _check(self, line: str) -> None:
        if line == "start":
            self._is_homed = False
            raise NoDeviceError(
                f"{self.name} was reset: it does not know where it is any more: lift the tip, home again"
            )
        if "halted" in line or "kill" in line:
            self._is_homed = False
            raise NoDeviceError(f"{self.name} switched itself off ({line}): find out why, then reset it")
        if "endstops hit" in line:
            self._is_homed = False
            raise RefusedError(f"{self.name} ran into a switch ({line}): home it again, and check the soft limits")
        if "Home" in line and "First" in line:
            raise RefusedError(f"{self.name} is not homed ({line}): home it first")
        if "Unknown command" in line:
            raise RefusedError(f"{self.name} does not know a command ({line}): does it run Marlin?")


def _numbered(number: int, text: str) -> bytes:
    """A line with its number and the exclusive or of its bytes."""
    body = text.encode() if text.startswith("M110") else f"N{number} {text}".encode()
    return body + b"*%d\n" % functools.reduce(int.__xor__, body)
