"""The live twin: a camera on a UNIX socket, for `ruffinid --camera twin:SOCKET`.

The bytes are described in firmware/capture/twin_camera.h. Frame i of a scenario is the same picture, bit for
bit, whenever it is made: its noise follows from (seed, i). Paced, frames that the twin is late for are
skipped as a camera would; in lockstep every frame is made. Of a board whose lamps alternate each frame is two of
the camera's: number 2 i with the lamps off, then 2 i + 1 with them on.
"""

from __future__ import annotations

import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.scenario import Scenario
from ruffini.sim.story import play
from ruffini.sim.unit import Progress

Array = npt.NDArray[np.float64]

VERSION = 1
POLL_S = 0.1  # between two looks at whether to stop
LOCKSTEP, PACED = b"L", b"P"
MAX_SPEED_M_S = 0.02  # of a steered indenter


States = tuple[Array, Array | None, TrayPose | None]


class Frames(Protocol):
    """Where the surface is in each frame."""

    def states(self, frame: int) -> States | None:
        """Surface displacement (n, 3), metres, in a frame and in the one before, if any, and where the tray is.

        None = the end.
        """


class Resting:
    """n frames in which nothing touches: what bodies without mechanics can show."""

    def __init__(self, renderer: Renderer, n: int) -> None:
        self._at_rest, self._n = renderer.at_rest(), n

    def states(self, frame: int) -> States | None:
        return (self._at_rest, self._at_rest, None) if frame < self._n else None


class Scripted:
    """A scenario's frames, worked out before the first one is shown."""

    def __init__(self, unit: Unit, scenario: Scenario, progress: Progress = lambda _: None) -> None:
        from ruffini.sim.programs import n_frames_of

        story = scenario.story(unit.board)
        total = n_frames_of(story)
        self._frames = []
        for moment in play(unit, story):
            self._frames.append((moment.displacement.copy(), moment.tray))
            progress(len(self._frames) / total)

    def __len__(self) -> int:
        return len(self._frames)

    def states(self, frame: int) -> States | None:
        if frame >= len(self._frames):
            return None
        displacement, tray = self._frames[frame]
        return displacement, self._frames[frame - 1][0] if frame else None, tray


class Steered:
    """An indenter that goes where it is told, at most at MAX_SPEED_M_S; without end."""

    def __init__(self, unit: Unit, indenter: Indenter) -> None:
        self._rig = unit.rig()
        self._rig.take(indenter)
        self._step_m = MAX_SPEED_M_S * 1e3 / unit.board.camera.rate_mhz
        self._pose: Pose | None = None
        self._target: Pose | None = None
        self._lock = threading.Lock()

    @property
    def wrench(self) -> Array:
        """What the ball does to the pad now: force (N) and moment (N m), (6,)."""
        return self._rig.wrench()

    def move_to(self, target: Pose) -> None:
        """From the next frame on, go there. Any thread. A first touch starts above its place."""
        with self._lock:
            self._target = target

    def states(self, frame: int) -> States | None:
        before = self._rig.displacement
        return self._move(), before, self._rig.tray

    def _move(self) -> Array:
        with self._lock:
            target = self._target
        if target is None:
            return self._rig.displacement
        if self._pose is None:
            self._pose = Pose(target.x_m, target.y_m, 0.0, target.turn_rad)
        way = np.hypot(np.hypot(target.x_m - self._pose.x_m, target.y_m - self._pose.y_m),
                       target.depth_m - self._pose.depth_m)  # fmt: skip
        pose = self._pose.towards(target, min(1.0, self._step_m / way)) if way > 0 else target
        try:
            self._rig.advance(pose)
            self._pose = pose
        except InputError as error:  # stays where it is until it is told another place
            print(error, file=sys.stderr)
            with self._lock:
                self._target = self._pose
        return self._rig.displacement


def steer_from(lines: Iterable[str], steered: Steered) -> None:
    """Move a steered indenter by lines of x, y, depth in millimetres; a line that is none is named on stderr."""
    for line in lines:
        try:
            x, y, depth = (float(word) * 1e-3 for word in line.split())
        except ValueError:
            print(f"not x_mm y_mm depth_mm: {line.strip()!r}", file=sys.stderr)
            continue
        steered.move_to(Pose(x, y, depth))


class TwinServer:
    """Serves one camera at a time, each from frame 0. `with` runs it in a thread."""

    def __init__(self, renderer: Renderer, frames: Frames, scenario: Scenario, path: Path) -> None:
        self._board, self._renderer = renderer.board, renderer
        self._frames, self._scenario, self._path = frames, scenario, path
        self._kept: dict[tuple[int, bool], bytes] = {}  # (frame, is it the unlit one)
        self._n_kept = 0  # frames; then they begin again
        self._stop = threading.Event()
        self._listener = _listen(path)
        self._thread = threading.Thread(target=self.run, daemon=True)
        self.n_sent = 0
        self.after_sending: Callable[[int], None] = lambda _: None  # told the frame that the camera just got
        self.next_frame: Callable[[], int] | None = None  # in lockstep: the number of the next one, once it is wanted

    def __enter__(self) -> TwinServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._thread.join()

    def close(self) -> None:
        """Stop serving and remove the socket. Any thread."""
        self._stop.set()

    def run(self, *, once: bool = False) -> None:
        """Serve until `close`, or until the first camera has gone."""
        try:
            while not self._stop.is_set():
                try:
                    camera, _ = self._listener.accept()
                except TimeoutError:
                    continue
                with camera:
                    camera.settimeout(POLL_S)
                    self._serve(camera)
                if once:
                    return
        finally:
            self._listener.close()
            self._path.unlink(missing_ok=True)

    def picture(self, frame: int) -> npt.NDArray[np.uint8] | None:
        """Frame `frame` as the frame path would get it; None = the end."""
        states = self._frames.states(frame)
        return None if states is None else self._scenario.computed_from(self._renderer, frame, *states)

    def keep(self, n: int, progress: Progress = lambda _: None) -> None:
        """Make the pictures of the first n frames now, and serve those without end: no camera waits for one.

        To draw one takes longer than a camera's interval. In memory they take n times a picture's size.
        """
        kept: dict[tuple[int, bool], bytes] = {}
        for frame in range(n):
            states = self._frames.states(frame)
            assert states is not None, "n is more than there are"
            for is_unlit in (False, True)[: 1 + self._board.alternates]:
                kept[frame, is_unlit] = self._drawn(frame, states, is_unlit=is_unlit)
            progress((frame + 1) / n)
        self._kept, self._n_kept = kept, n

    def _drawn(self, frame: int, states: States, *, is_unlit: bool = False) -> bytes:
        if self._n_kept:
            return self._kept[frame % self._n_kept, is_unlit]
        return self._scenario.picture(self._renderer, frame, *states, is_unlit=is_unlit).tobytes()

    def _serve(self, camera: socket.socket) -> None:
        settings = self._board.camera
        name = self._board.name.encode()
        sizes = settings.width_px, settings.height_px, settings.rate_mhz
        try:
            self._send(camera, struct.pack("<4s5I", b"RFTC", VERSION, *sizes, len(name)) + name)
            mode = self._receive_mode(camera)
            if mode:
                self._stream(camera, is_paced=mode == PACED)
        except (BrokenPipeError, ConnectionResetError):
            return  # the camera went; the next one may come

    def _receive_mode(self, camera: socket.socket) -> bytes:
        while not self._stop.is_set():
            try:
                return camera.recv(1)
            except TimeoutError:
                continue
        return b""

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        period_s = 1e3 / self._board.camera.rate_mhz
        start, frame = time.monotonic(), 0
        while not self._stop.is_set():
            if is_paced:
                late_s = time.monotonic() - start - frame * period_s
                if late_s < 0:
                    self._stop.wait(-late_s)
                frame += max(0, int(late_s / period_s))
            elif self.next_frame is not None:
                frame = self.next_frame()
            states = self._frames.states(frame % self._n_kept if self._n_kept else frame)
            if states is None:
                self._send(camera, struct.pack("<4sIQ", b"RFTF", 0, frame))
                return
            if self._board.alternates and self._scenario.is_sent(frame, is_unlit=True):
                dark = self._drawn(frame, states, is_unlit=True)
                self._send(camera, struct.pack("<4sIQ", b"RFTF", len(dark), 2 * frame) + dark)
            if self._scenario.is_sent(frame):
                data = self._drawn(frame, states)
                number = 2 * frame + 1 if self._board.alternates else frame
                self._send(camera, struct.pack("<4sIQ", b"RFTF", len(data), number) + data)
                self.n_sent += 1
                self.after_sending(frame)
            frame += 1

    def _send(self, camera: socket.socket, data: bytes) -> None:
        """All of it, however slowly the camera reads, unless the twin is to stop."""
        view = memoryview(data)
        while view and not self._stop.is_set():
            try:
                view = view[camera.send(view) :]
            except TimeoutError:
                continue


def _listen(path: Path) -> socket.socket:
    if path.is_socket():
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(str(path))
            except OSError:
                path.unlink(missing_ok=True)  # left over by a twin that died
            else:
                raise InputError(f"{path}: another twin serves there: stop it, or choose another --socket")
    listener = socket.socket(socket.AF_UNIX)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise InputError(f"{path}: cannot serve there ({error}): choose another --socket") from error
    listener.listen(1)
    listener.settimeout(POLL_S)
    return listener
