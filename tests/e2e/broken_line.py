"""A USB serial line that loses pieces and is unplugged, between the real daemon and the real host tool."""

from __future__ import annotations

import contextlib
import os
import random
import select
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hang import until

from ruffini.device import Connection

PIECE_BYTES = 512  # what a full-speed link carries at once, and loses at once


class BrokenLine:
    """Two ends of a line with this in between; `port` is where the host finds it, plugged in or not.

    Each piece is lost with probability `loss`, each way.
    """

    def __init__(self, device_port: str, folder: Path, *, seed: int = 1) -> None:
        self.port = str(folder / "line")
        self.loss, self.n_lost = 0.0, 0
        self._device_port, self._random = device_port, random.Random(seed)
        self._lock = threading.Lock()
        self._device = self._host = -1
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def __enter__(self) -> BrokenLine:
        self.plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.unplug()

    def plug_in(self) -> None:
        """Both ends are there, the host's under another number than before."""
        with self._lock:
            self._device = os.open(self._device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            self._host, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(self._host, False)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)
            os.symlink(os.ttyname(slave), self.port)
            os.close(slave)

    def unplug(self) -> None:
        """Both ends hang up; what was on the way is lost."""
        with self._lock:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)
            for end in (self._device, self._host):
                if end >= 0:
                    os.close(end)
            self._device = self._host = -1

    def unplug_for(self, n_frames: int) -> None:
        """Unplugged while the device processes so many frames."""
        self.unplug()
        with Connection(self._device_port) as host:
            n_before = host.status().frames_processed
            until(lambda: host.status().frames_processed >= n_before + n_frames, f"{n_frames} frames")
        self.plug_in()

    def _carry(self) -> None:
        while not self._stop.is_set():
            with self._lock:
                ends = {self._device: self._host, self._host: self._device} if self._device >= 0 else {}
                moved = False
                for end in select.select(list(ends), [], [], 0)[0] if ends else []:
                    with contextlib.suppress(OSError):  # nobody has the host's end open
                        piece = os.read(end, PIECE_BYTES)
                        moved = bool(piece)
                        if self._random.random() < self.loss:
                            self.n_lost += 1
                            continue
                        self._write(ends[end], piece)
            if not moved:
                time.sleep(0.0005)

    @staticmethod
    def _write(end: int, piece: bytes) -> None:
        for _ in range(1000):
            with contextlib.suppress(BlockingIOError):
                piece = piece[os.write(end, piece) :]
            if not piece:
                return
            time.sleep(0.001)


def unplugged_host(line: BrokenLine, after: int, n_missed: int) -> type[Connection]:
    """A Connection whose line is unplugged once, when so many frames have come, for `n_missed` more."""

    class Host(Connection):
        n_wrenches = 0

        def stream(self, **how: Any) -> Iterator[tuple[Any, Any]]:
            for frame, message in super().stream(**how):
                yield frame, message
                self.n_wrenches += frame.type == self.schema.type_numbers["WRENCH"]
                if self.n_wrenches == after:
                    self.n_wrenches += 1
                    line.unplug_for(n_missed)

    return Host
