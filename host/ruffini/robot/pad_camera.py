"""The camera of one pad, in a process of its own: drawing does not wait for the physics, nor the physics for drawing.

The process, `python -m ruffini.robot.pad_camera FILE`, reads its pickled renderer, seed and socket from FILE, writes a
line once the socket is there, and takes surfaces (float64, one a message) from the socket that is its standard input.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from ruffini.errors import RuffiniError
from ruffini.older_python import Self
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import States, TwinServer

Array = npt.NDArray[np.float64]

READY = b"ready\n"
START_TIMEOUT_S = 60.0  # for Python and its libraries on a busy computer
END_TIMEOUT_S = 5.0


class PadCamera:
    """Serves pictures of the newest surface on `socket_path`, within `with`; its folder has a file of the same name."""

    def __init__(self, renderer: Renderer, socket_path: Path, seed: int) -> None:
        self._renderer, self._seed, self._socket_path = renderer, seed, socket_path

    def __enter__(self) -> Self:
        """Starts the process; `wait` for it."""
        settings = self._socket_path.with_suffix(".pickle")
        settings.write_bytes(pickle.dumps((self._renderer, self._seed, self._socket_path)))
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        environment = {**os.environ, **one_thread, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-m", "ruffini.robot.pad_camera", str(settings)]
        self._line, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._line.setblocking(False)
        with theirs:
            # In a session of its own: Ctrl-C is for this process, which then ends that one.
            self._process = subprocess.Popen(
                command, stdin=theirs.fileno(), stdout=subprocess.PIPE, env=environment, start_new_session=True
            )
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
            The process has ended, with the reason on standard error, or takes longer than START_TIMEOUT_S.
        """
        assert self._process.stdout is not None
        is_heard, _, _ = select.select([self._process.stdout], [], [], START_TIMEOUT_S)
        if not is_heard or self._process.stdout.readline() != READY:
            raise RuffiniError("the camera of a pad did not start: read what its process printed to standard error")

    def show(self, surface: Array) -> None:
        """Displacement of the surface's nodes, (n, 3) metres, from the next picture on. Never waits.

        A process that stands still or has gone is a camera that is silent.
        """
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionError):
            self._line.send(np.ascontiguousarray(surface, np.float64).tobytes())

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.close()  # which ends the process
        assert self._process.stdout is not None
        self._process.stdout.close()
        try:
            self._process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class _Shown:
    """The newest surface, for the camera (`serve.Frames`)."""

    def __init__(self, at_rest: Array) -> None:
        self._states: States = (at_rest, at_rest, None)

    def follow(self, line: socket.socket) -> None:
        """Take surfaces until the other side is closed."""
        while data := line.recv(self._states[0].nbytes):
            self._states = (np.frombuffer(data).reshape(-1, 3), self._states[0], None)

    def states(self, frame: int) -> States | None:
        """What the camera sees; it never ends."""
        return self._states


def main() -> None:
    import cv2

    cv2.setNumThreads(1)  # other cores have other pads
    renderer, seed, socket_path = pickle.loads(Path(sys.argv[1]).read_bytes())
    shown = _Shown(renderer.at_rest().reshape(-1, 3))
    with TwinServer(renderer, shown, Scenario(program="rest", seed=seed), socket_path):
        sys.stdout.buffer.write(READY)
        sys.stdout.buffer.flush()
        shown.follow(socket.socket(fileno=sys.stdin.fileno()))


if __name__ == "__main__":
    main()
