"""The camera of one pad, in a process of its own: drawing does not wait for the physics, nor the physics for drawing.

The process, `python -m ruffini.robot.pad_camera`, reads the pickled renderer, seed and socket on standard input, writes
a line when the socket is there, and then reads surfaces as float64 until its input ends.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from ruffini.errors import RuffiniError
from ruffini.older_python import Self
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import States, TwinServer

Array = npt.NDArray[np.float64]

READY = b"ready\n"


class PadCamera:
    """Serves pictures of the newest surface on `socket`, within `with`."""

    def __init__(self, renderer: Renderer, socket: Path, seed: int) -> None:
        self._told = pickle.dumps((renderer, seed, socket))

    def __enter__(self) -> Self:
        """Returns while the process starts; `wait` for it."""
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        environment = {**os.environ, **one_thread, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-m", "ruffini.robot.pad_camera"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
        )  # Ctrl-C is this process's, which then ends it
        self._write(self._told)
        return self

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    def wait(self) -> None:
        """Until the socket is there.

        Raises
        ------
        RuffiniError
            The process has ended; it has said why on standard error.
        """
        assert self._process.stdout is not None
        if self._process.stdout.readline() != READY:
            raise RuffiniError("the camera of a pad did not start: its process says why above")

    def show(self, surface: Array) -> None:
        """Displacement of the surface's nodes, (n, 3) metres, from the next picture on.

        A process that has gone is a camera that is silent.
        """
        self._write(np.ascontiguousarray(surface, np.float64).tobytes())

    def _write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(BrokenPipeError):
            self._process.communicate()  # the end of its input is its end


class _Shown:
    """The newest surface, for the camera (`serve.Frames`)."""

    def __init__(self, renderer: Renderer) -> None:
        self._now = self._before = renderer.at_rest().reshape(-1, 3)

    def follow(self, stream: BinaryIO) -> None:
        """Read surfaces until the stream ends."""
        while len(data := stream.read(self._now.nbytes)) == self._now.nbytes:
            self._before, self._now = self._now, np.frombuffer(data).reshape(-1, 3)

    def states(self, frame: int) -> States | None:
        """What the camera sees; it never ends."""
        return self._now, self._before, None


def main() -> None:
    import cv2

    cv2.setNumThreads(1)  # other cores have other pads
    stream = sys.stdin.buffer
    renderer, seed, socket = pickle.load(stream)
    shown = _Shown(renderer)
    with TwinServer(renderer, shown, Scenario(program="rest", seed=seed), socket):
        sys.stdout.buffer.write(READY)
        sys.stdout.buffer.flush()
        shown.follow(stream)


if __name__ == "__main__":
    main()
