"""Pads of a world as real sensors: each is a camera process and a `ruffinid`.

A program opens `Live.ports` with `ruffini.connect` as it would the hardware. `HeldSensor` is what a controller reads:
the newest frame, and a sentence where the line is silent, so that the grip is held.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from pathlib import Path

from ruffini.api.frame import SensorFrame
from ruffini.api.sensor import Sensor
from ruffini.daemon import Daemon, started_daemon
from ruffini.errors import NoDeviceError
from ruffini.robot.pad_camera import PadCamera
from ruffini.robot.world import World

CATCH_UP = 5  # frames; a computer that is too slow altogether must not hurry for ever after it
SILENCE_S = 0.5  # without a frame, after which the grip is held


class Live:
    """Daemons and cameras of a world's pads. Make the world with `is_feeling=False`; step it here.

    Attributes
    ----------
    ports : of each pad, for `ruffini.connect`.
    cameras, daemons : processes of each pad.
    """

    def __init__(self, world: World, *, seed: int = 1) -> None:
        self.world, self._seed = world, seed
        self.ports: dict[str, str] = {}
        self.daemons: dict[str, Daemon] = {}
        self.cameras: dict[str, PadCamera] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Live:
        with contextlib.ExitStack() as begun:
            folder = Path(begun.enter_context(tempfile.TemporaryDirectory(prefix="ruffini-")))
            sockets = {name: folder / f"{i}.socket" for i, name in enumerate(self.world.pads)}
            for i, (name, pad) in enumerate(self.world.pads.items()):
                camera = PadCamera(pad.solid.unit.renderer(), sockets[name], self._seed + i)
                self.cameras[name] = begun.enter_context(camera)
            for name, pad in self.world.pads.items():
                self.cameras[name].wait()
                board, path = pad.solid.unit.board.folder, sockets[name]
                assert board is not None
                daemon = begun.enter_context(started_daemon(board, f"twin:{path}", path.with_suffix(".store")))
                self.daemons[name], self.ports[name] = daemon, daemon.port
            self._stack.push(begun.pop_all())
        self._next_s = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def step(self) -> None:
        """Physics of one frame, shown to the cameras, at the clock's pace; CATCH_UP late frames are made up for."""
        self.world.step()
        for name, camera in self.cameras.items():
            camera.show(self.world.pads[name].contact.surface_displacement())
        now = time.monotonic()
        time.sleep(max(0.0, self._next_s - now))
        self._next_s = max(self._next_s, now - CATCH_UP * self.world.frame_s) + self.world.frame_s


class HeldSensor:
    """A sensor that a controller asks for the newest frame; silence is a sentence, not an exception.

    Attributes
    ----------
    problem : why the grip is to be held; empty while frames come.
    """

    def __init__(self, sensor: Sensor, silence_s: float = SILENCE_S) -> None:
        self._port, self._silence_s = sensor.port, silence_s
        self._frames = sensor.frames(newest=True)
        self._heard_s = time.monotonic()
        self.problem = ""

    def newest(self) -> SensorFrame | None:
        """The newest valid frame since the last call; None: there is none, keep the grip as it is."""
        try:
            frame = self._frames.get(0.0)
        except (NoDeviceError, StopIteration) as error:
            self.problem = f"{self._port}: the sensor is gone ({error}): the grip is held; look at its cable and daemon"
            return None
        now = time.monotonic()
        if frame is not None and frame.is_valid:
            self._heard_s, self.problem = now, ""
            return frame
        if now - self._heard_s > self._silence_s:
            silence = f"no valid frame for {self._silence_s:g} s"
            self.problem = f"{self._port}: {silence}: the grip is held; look at its cable and daemon"
        return None
