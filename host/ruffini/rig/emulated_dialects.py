"""Marlin and GRBL as the emulated machine speaks them."""

from __future__ import annotations

import functools
import re
import time

from ruffini import host_clock
from ruffini.rig.emulated_machine import MAX_BLOCKS, EmulatedMachine
from ruffini.rig.stage import Place, Rotary

WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d+)?)")
BUSY_S = 0.5  # between two notes that a command takes time; real, as the patience of who waits for the answer


def _target(machine: EmulatedMachine, text: str, *, is_relative: bool = False) -> tuple[Place, float | None]:
    """Where a G1 leads from what is planned, and its speed (m/s)."""
    words = {letter: float(value) for letter, value in WORD.findall(text)}
    machine.turned |= {axis: words[axis] for axis in machine.turned if axis in words}
    last = machine.blocks[-1].end
    ways = {a: 1e-3 * words[a] for a in "XYZ" if a in words}
    speed_m_s = words["F"] / 60e3 if "F" in words else None
    if (rotary := machine.rotary) is not None:
        ways.pop("X", None)  # the way round what it turns is the other axis's
        if rotary.letter in words:
            ways["X"] = rotary.way_m(words[rotary.letter])
            speed_m_s = rotary.way_m(words["F"] / 60) if "F" in words else None
    place = Place(*(ways[a] + is_relative * v if a in ways else v for a, v in zip("XYZ", last, strict=True)))
    return place, speed_m_s


def _axes(machine: EmulatedMachine, place: Place) -> tuple[list[float], float | None]:
    """Its straight axes in mm, and the degrees of the one that turns, as it tells them."""
    x, y, z = (1e3 * v for v in place)
    rotary = machine.rotary
    return ([x, y, z], None) if rotary is None else ([1e3 * rotary.x_m, y, z], rotary.degrees(place.x_m))


class EmulatedMarlin(EmulatedMachine):
    """Checks numbers and checksums; `garble` counts lines that it will not understand."""

    garble = 0

    def __init__(
        self, *, bottom_z_m: float = -0.1, has_emergency_parser: bool = True, rotary: Rotary | None = None,
        turns: str = "",
    ) -> None:  # fmt: skip
        super().__init__(bottom_z_m=bottom_z_m, rotary=rotary, turns=turns)
        self._has_emergency_parser = has_emergency_parser
        self._last_number, self._is_relative = 0, False
        self._answer: list[str] = []  # said once it stands still
        self._noted_s = 0.0

    def is_ready(self) -> bool:
        if self._answer and self.is_moving():
            if time.monotonic() - self._noted_s > BUSY_S:
                self.say("echo:busy: processing")
                self._noted_s = time.monotonic()
            return False
        self.say(*self._answer)
        self._answer = []
        return True

    def realtime(self, data: bytes) -> bytes:
        if self._has_emergency_parser and b"M410" in data:
            self.freeze()
        return data

    def greet(self) -> None:
        self._last_number = 0
        self.say("start", "echo:Marlin 2.1.2")

    def obey(self, line: str) -> None:
        body, star, checksum = line.rpartition("*")
        if star:
            is_right = checksum == str(functools.reduce(int.__xor__, body.encode()))
            if not is_right or self.garble:
                self.garble -= 1
                self.say(
                    f"Error:checksum mismatch, Last Line: {self._last_number}", f"Resend: {self._last_number + 1}", "ok"
                )
                return
            if body.startswith("M110"):
                self._last_number = int(body.split("N")[1])
            else:
                number, _, body = body.removeprefix("N").partition(" ")
                if int(number) != self._last_number + 1:
                    self.say(f"Error:Line Number is not Last Line Number+1, Last Line: {self._last_number}",
                             f"Resend: {self._last_number + 1}", "ok")  # fmt: skip
                    return
                self._last_number = int(number)
        self._do(body or line)

    def _do(self, text: str) -> None:
        code = text.split()[0]
        if code == "G28":
            self.find_home()
        elif code == "M114":
            (x, y, z), turned = _axes(self, self.blocks[-1].end)
            more = f" {self.rotary.letter}:{turned:.4f}" if self.rotary else ""
            more += "".join(f" {axis}:{angle:.2f}" for axis, angle in self.turned.items())
            self.say(f"X:{x:.4f} Y:{y:.4f} Z:{z:.4f}{more} E:0.00 Count X:0 Y:0 Z:0")
        elif code == "M400":
            self._answer, self._noted_s = ["ok"], time.monotonic()
            return
        elif code == "M410":
            self.freeze()
        elif code in ("G90", "G91"):
            self._is_relative = code == "G91"
        elif code in ("G0", "G1"):
            if not self.is_homed:
                self.say("echo:Home XYZ First")
            else:
                place, speed_m_s = _target(self, text, is_relative=self._is_relative)
                if not self.go(place, speed_m_s or 0.01):
                    self._answer = [f"echo:endstops hit:  Z:{1e3 * self.bottom_z_m:.2f}", "ok"]
                    return
        elif code not in ("G21", "M110"):
            self.say(f'echo:Unknown command: "{text}"')
        self.say("ok")


class EmulatedGrbl(EmulatedMachine):
    """Realtime ?, ! and reset; alarm lock until it is homed."""

    def __init__(self, *, bottom_z_m: float = -0.1, rotary: Rotary | None = None, turns: str = "") -> None:
        super().__init__(bottom_z_m=bottom_z_m, rotary=rotary, turns=turns)
        self._is_locked, self._is_held, self._has_hit = True, False, False

    def greet(self) -> None:
        self._is_locked = self._is_locked or not self.is_homed
        self.say("Grbl 1.1h ['$' for help]", *(["[MSG:'$H'|'$X' to unlock]"] if self._is_locked else []))

    def realtime(self, data: bytes) -> bytes:
        for character in data:
            if character == ord("?"):
                self._report()
            elif character == ord("!"):
                self.freeze()
                self._is_held = True
            elif character == 0x18:
                self._soft_reset()
        return bytes(c for c in data if c not in b"?!\x18")

    def _soft_reset(self) -> None:
        if self.is_moving():
            self._alarm(3)
        self.freeze()
        self._is_held = False
        self.greet()

    def _alarm(self, number: int) -> None:
        self.freeze()
        self._is_locked, self.is_homed, self._has_hit = True, False, False
        self.say(f"ALARM:{number}")

    def _report(self) -> None:
        if self._has_hit and not self.is_moving():
            self._alarm(1)
        state = "Alarm" if self._is_locked else "Hold:0" if self._is_held else "Run" if self.is_moving() else "Idle"
        (x, y, z), turned = _axes(self, self.reported())
        more = "".join(f",{v:.3f}" for v in [*([] if turned is None else [turned]), *self.turned.values()])
        self.say(f"<{state}|MPos:{x:.3f},{y:.3f},{z:.3f}{more}|FS:0,0>")

    def obey(self, line: str) -> None:
        text = line.removeprefix("G53 ")
        if text == "$H":
            self.find_home()
            self._is_locked = False
        elif text == "$X":
            self._is_locked = False
        elif self._is_locked:
            return self.say("error:9")
        elif text.startswith(("G1", "$J=G91")):
            place, speed_m_s = _target(self, text, is_relative="G91" in text)
            if speed_m_s is None:
                return self.say("error:22")
            while len([b for b in self.blocks if b.end_s > host_clock.now()]) >= MAX_BLOCKS:
                time.sleep(0.001)
            self._has_hit = not self.go(place, speed_m_s)
        elif text not in ("G21", "G90", "G53"):
            return self.say("error:20")
        return self.say("ok")
