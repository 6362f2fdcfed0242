"""An emulated G-code machine that moves in real time and can be disturbed like a real one."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from typing import NamedTuple

from ruffini import host_clock
from ruffini.rig.stage import Place, Rotary

HOME_PLACE = Place(0.0, 0.0, 0.05)
HOMING_S = 0.1
MAX_BLOCKS = 15  # moves that are planned ahead


class Block(NamedTuple):
    """One straight move."""

    start: Place
    end: Place
    start_s: float
    end_s: float

    def at(self, time_s: float) -> Place:
        """Where the tip is at a time."""
        if time_s >= self.end_s:
            return self.end
        part = max(0.0, (time_s - self.start_s) / (self.end_s - self.start_s))
        return Place(*(a + part * (b - a) for a, b in zip(self.start, self.end, strict=True)))


class EmulatedMachine:
    """Motion and line of a machine on a pty; dialects say what it answers. `with` runs it."""

    def __init__(self, *, bottom_z_m: float = -0.1, rotary: Rotary | None = None, turns: str = "") -> None:
        self._board, host = pty.openpty()
        self._host = host
        tty.setraw(host)
        self.port = os.ttyname(host)
        self.lock = threading.RLock()
        self.blocks: list[Block] = [Block(HOME_PLACE, HOME_PLACE, 0.0, 0.0)]
        self.slip = Place(0.0, 0.0, 0.0)  # steps that the motors lost
        self.bottom_z_m = bottom_z_m  # of its lower limit switch
        self.rotary = rotary  # turns what is pressed: x is then the way round it
        self.turned = dict.fromkeys(turns, 0.0)  # degrees of the axes that tilt what is pressed
        self.is_homed, self.is_deaf = False, False
        self.received: list[str] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="machine", daemon=True)

    # ---- motion -------------------------------------------------------------------------------

    def place(self, time_s: float | None = None) -> Place:
        """Where the tip really is, in the machine's coordinates. Any thread."""
        return self.reported(time_s).plus(self.slip)

    def reported(self, time_s: float | None = None) -> Place:
        """Where the machine believes it is."""
        now = host_clock.now() if time_s is None else time_s
        with self.lock:
            for block in self.blocks:
                if now < block.end_s:
                    return block.at(now)
            return self.blocks[-1].end

    def is_moving(self) -> bool:
        """Is there way to go?"""
        with self.lock:
            return host_clock.now() < self.blocks[-1].end_s

    def go(self, end: Place, speed_m_s: float) -> bool:
        """Plan one more move; False where it ends at the limit switch."""
        now = host_clock.now()
        with self.lock:
            self.blocks = [b for b in self.blocks[:-1] if b.end_s > now] + self.blocks[-1:]
            start, start_s = self.blocks[-1].end, max(now, self.blocks[-1].end_s)
            is_free = end.z_m >= self.bottom_z_m
            if not is_free:
                part = (start.z_m - self.bottom_z_m) / (start.z_m - end.z_m)
                end = Place(*(a + part * (b - a) for a, b in zip(start, end, strict=True)))
            self.blocks.append(Block(start, end, start_s, start_s + start.distance(end) / speed_m_s))
        return is_free

    def freeze(self) -> None:
        """Stand still where the tip is now; what was planned is forgotten."""
        with self.lock:
            here = self.reported()
            self.blocks = [Block(here, here, 0.0, 0.0)]

    def find_home(self) -> None:
        """What homing does: stand at the switches, position known."""
        host_clock.sleep(HOMING_S)
        with self.lock:
            self.blocks = [Block(HOME_PLACE, HOME_PLACE, 0.0, 0.0)]
            self.slip, self.is_homed = Place(0.0, 0.0, 0.0), True

    # ---- disturbances -------------------------------------------------------------------------

    def power_glitch(self) -> None:
        """Supply dips: motors stop, position is forgotten, it greets."""
        with self.lock:
            self.freeze()
            self.is_homed = False
        self.greet()

    def unplug(self) -> None:
        """Disconnect the cable."""
        self._stop.set()
        self._thread.join()
        for descriptor in (self._board, self._host):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    # ---- line ---------------------------------------------------------------------------------

    def __enter__(self) -> EmulatedMachine:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._stop.is_set():
            self.unplug()

    def say(self, *lines: str) -> None:
        """Lines to the host."""
        if lines and not self.is_deaf:
            with contextlib.suppress(OSError):
                os.write(self._board, "".join(f"{line}\r\n" for line in lines).encode())

    def greet(self) -> None:
        """What it says when it starts."""
        raise NotImplementedError

    def obey(self, line: str) -> None:
        """One line from the host."""
        raise NotImplementedError

    def realtime(self, data: bytes) -> bytes:
        """Act on characters that are no part of lines; what is left. By default there are none."""
        return data

    def is_ready(self) -> bool:
        """Does it take the next line now?"""
        return True

    def _run(self) -> None:
        partial, waiting = b"", list[str]()
        while not self._stop.is_set():
            while waiting and self.is_ready():
                self.obey(waiting.pop(0))
            if not self.is_ready():
                time.sleep(0.001)
            if not select.select([self._board], [], [], 0.002)[0]:
                continue
            try:
                data = os.read(self._board, 4096)
            except OSError:  # no host has it open
                self._stop.wait(0.02)
                continue
            *lines, partial = (partial + self.realtime(data)).split(b"\n")
            for line in lines:
                text = line.decode("ascii", "replace").strip()
                self.received.append(text)
                waiting += [text] if text else []
