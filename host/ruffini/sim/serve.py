"""The live twin: a camera on a UNIX socket, for `ruffinid --camera twin:SOCKET`.

The bytes are described in firmware/capture/twin_camera.h. Frame i of a scenario is the same picture, bit for
bit, whenever it is made: its noise follows from (seed, i). Paced, frames that the twin is late for are
skipped as a camera would; in lockstep every frame is made. Of a board whose lamps alternate each frame is two of
the camera's: number 2 i with the lamps off, then 2 i + 1 with them on.
"""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.frame_server import FrameServer
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.sim.scenario import Scenario
from ruffini.sim.story import play
from ruffini.sim.unit import Progress

Array = npt.NDArray[np.float64]

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


class Clock(Protocol):
    """Simulated time that the frames of a camera in lockstep drive (`ruffini.rig.frame_clock`)."""

    def next_frame(self) -> int:
        """The number of the next frame, once it is wanted."""

    def has_drawn(self) -> None:
        """The frame is there, and is sent now."""

    def without_frames(self) -> None:
        """The camera has gone, or has its last frame."""


class TwinServer(FrameServer):
    """Serves one camera at a time, each from frame 0. `with` runs it in a thread."""

    def __init__(self, renderer: Renderer, frames: Frames, scenario: Scenario, path: Path) -> None:
        super().__init__(renderer.board, path, magic=b"RFTC", rate_mhz=renderer.board.camera.rate_mhz)
        self._renderer = renderer
        self._frames, self._scenario = frames, scenario
        self._kept: dict[tuple[int, bool], bytes] = {}  # (frame, is it the unlit one)
        self._n_kept = 0  # frames; then they begin again
        self.n_sent = 0
        self.after_sending: Callable[[int], None] = lambda _: None  # told the frame that the camera just got
        self.clock: Clock | None = None  # in lockstep

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

    def _stream(self, camera: socket.socket, *, is_paced: bool) -> None:
        try:
            self._stream_frames(camera, is_paced=is_paced)
        finally:
            if self.clock is not None:
                self.clock.without_frames()

    def _stream_frames(self, camera: socket.socket, *, is_paced: bool) -> None:
        frame = 0
        while not self._stop.is_set():
            if is_paced:
                frame = self._wait_for(frame)
            elif self.clock is not None:
                frame = self.clock.next_frame()
            states = self._frames.states(frame % self._n_kept if self._n_kept else frame)
            if states is None:
                self._send_frame(camera, frame, b"")
                return
            kinds = (True, False) if self._board.alternates else (False,)
            drawn = {
                is_unlit: self._drawn(frame, states, is_unlit=is_unlit)
                for is_unlit in kinds
                if self._scenario.is_sent(frame, is_unlit=is_unlit)
            }
            if self.clock is not None:
                self.clock.has_drawn()
            for is_unlit, data in drawn.items():
                number = 2 * frame + (not is_unlit) if self._board.alternates else frame
                self._send_frame(camera, number, data)
            if False in drawn:
                self.n_sent += 1
                self.after_sending(frame)
            frame += 1
