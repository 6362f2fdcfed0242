"""A twin's camera that gives a frame when a test says so, and a host that drives it by what it hears."""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from daemon_time import DaemonTime
from hang import HANG_S, until
from tiny_twin import Twin

from ruffini.device import Connection
from ruffini.sim.scenario import Scenario

N_SILENT = 20  # reads of 20 ms
N_PICTURES = 4  # no two frames in a row are the same: that would be a fault


class HandTwin:
    """What `ruffini sim serve` is to the daemon (firmware/capture/twin_camera.h), of a pad that nothing touches."""

    def __init__(self, twin: Twin, path: Path) -> None:
        self._board = twin.board
        renderer, rest = twin.unit.renderer(), twin.unit.at_rest()
        self.pictures = [Scenario().picture(renderer, i, rest, rest).tobytes() for i in range(N_PICTURES)]
        self.number = 0  # of the next frame
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen(1)
        self._camera: Future[socket.socket] = Future()
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=self._greet, daemon=True)]

    def __enter__(self) -> HandTwin:
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._listener.close()
        if self._camera.done():
            self._camera.result().close()

    def _greet(self) -> None:
        camera, _ = self._listener.accept()
        settings, name = self._board.camera, self._board.name.encode()
        sizes = settings.width_px, settings.height_px, settings.rate_mhz, len(name)
        camera.sendall(struct.pack("<4s5I", b"RFTC", 1, *sizes) + name)
        camera.recv(1)  # paced or lockstep: here it is all the same
        self._camera.set_result(camera)

    def frame(self) -> None:
        """Send one more."""
        data = self.pictures[self.number % len(self.pictures)]
        self._camera.result(HANG_S).sendall(struct.pack("<4sIQ", b"RFTF", len(data), self.number) + data)
        self.number += 1

    def is_read(self) -> bool:
        """True if the device has taken all that was sent."""
        left = fcntl.ioctl(self._camera.result(HANG_S), termios.TIOCOUTQ, b"\0" * 4)
        return struct.unpack("i", left)[0] == 0

    def run(self) -> None:
        """Send frames from now on, at most 200 a second: of a trial the host bears 1024 that nobody judged."""

        def send() -> None:
            try:
                while not self._stop.wait(5e-3):
                    self.frame()
            except OSError:
                pass  # the device or the test has ended

        self._threads.append(threading.Thread(target=send, daemon=True))
        self._threads[-1].start()


def settle(sensor: Connection, n_frames: int) -> Any:
    """STATUS when the device has processed `n_frames` and has looked at the time since.

    It looks before it reads what is asked: the second answer is of after that look.
    """
    until(lambda: sensor.status().frames_processed >= n_frames, f"frame {n_frames}")
    sensor.status()
    return sensor.status()


def stalling_host(camera: HandTwin, time: DaemonTime, period_s: float, *, after: int, n_stale: int) -> type[Connection]:
    """A Connection that asks for the next frame when it has one, and lets the camera stand still once.

    After `after` frames time goes on without a frame until `n_stale` repeated results have come.
    """

    class Host(Connection):
        n_fresh = n_repeated = n_silent = 0

        def subscribe(self, **every: int) -> None:
            super().subscribe(**every)
            if self.n_fresh == 0:
                camera.frame()

        def _read(self) -> None:
            n_before = self.messages.n_added
            super()._read()
            is_owed = self.n_fresh < after or self.n_repeated >= n_stale
            self.n_silent = self.n_silent + 1 if is_owed and self.messages.n_added == n_before else 0
            if self.n_fresh and self.n_silent == N_SILENT:  # one sent when time had jumped is passed over as old
                self.n_silent = 0
                time.advance(period_s)
                camera.frame()

        def stream(self, **how: Any) -> Iterator[tuple[Any, Any]]:
            numbers = self.schema.type_numbers
            for frame, message in super().stream(**how):
                yield frame, message
                if frame.type != numbers["WRENCH"]:
                    continue
                is_stale = frame.sensor == 255
                self.n_fresh, self.n_repeated = self.n_fresh + (not is_stale), self.n_repeated + is_stale
                if self.n_fresh < after or self.n_repeated >= n_stale:
                    time.advance(period_s)
                    if not is_stale or self.n_repeated == n_stale:
                        camera.frame()
                elif self.n_repeated == 0:
                    # Its first look after the last frame may have been a period late.
                    time.advance(4.1 * period_s)
                else:
                    time.advance(0.1001)  # to the next repetition

    return Host


def listen(sensor: Connection) -> tuple[Callable[[], Any], list[Any]]:
    """A function that waits for the next WRENCH, and the EVENT messages that came before it so far."""
    stream, events, numbers = sensor.stream(timeout_s=HANG_S), [], sensor.schema.type_numbers

    def next_wrench() -> Any:
        for frame, message in stream:
            if frame.type == numbers["WRENCH"]:
                return message
            if frame.type == numbers["EVENT"]:
                events.append(message)
        raise AssertionError("hangs: no WRENCH came")

    return next_wrench, events
