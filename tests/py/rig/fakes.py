"""Devices that speak their real protocols: an FX29 at register level, a printing board on a pty, RDT over UDP."""

from __future__ import annotations

import contextlib
import errno
import os
import pty
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator


class FakeFx29:
    """The chip's own rules: an empty write starts a conversion, a read before it ends says stale."""

    CONVERSION_S = 0.0084

    def __init__(self, address: int, full_scale_n: float) -> None:
        self.address, self.full_scale_n = address, full_scale_n
        self.force_n, self.is_plugged, self.has_fault, self.is_broken = 0.0, True, False, False
        self._done_s: float | None = None
        self.is_open = True

    def i2c_rdwr(self, *messages) -> None:
        for message in messages:
            if not self.is_plugged or message.addr != self.address:
                raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
            if message.flags & 1:
                self._answer(message)
            else:
                self._done_s = time.monotonic() + self.CONVERSION_S

    def _answer(self, message) -> None:
        counts = 0 if self.is_broken else min(1000 + round(self.force_n / self.full_scale_n * 14000), 16383)
        status = 3 if self.has_fault else 0 if self._done_s and time.monotonic() >= self._done_s else 2
        self._done_s = None if status == 0 else self._done_s
        for i, byte in enumerate([status << 6 | counts >> 8, counts & 0xFF]):
            message.buf[i] = byte

    def close(self) -> None:
        self.is_open = False


@contextlib.contextmanager
def printing_board(line: Callable[[], str | bytes], period_s: float = 0.01) -> Iterator[tuple[str, Callable[[], None]]]:
    """A board that prints `line()` again and again; yields its port and what unplugs it."""
    board, host = pty.openpty()
    tty.setraw(host)
    port, stop = os.ttyname(host), threading.Event()

    def unplug() -> None:
        stop.set()
        thread.join()
        with contextlib.suppress(OSError):
            os.close(board)
            os.close(host)

    def run() -> None:
        while not stop.wait(period_s):
            text = line()
            os.write(board, text if isinstance(text, bytes) else text.encode() + b"\r\n")

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield port, unplug
    finally:
        if not stop.is_set():
            unplug()


class RdtServer:
    """A force/torque box on loopback: streams when asked, stops when asked, can lose and repeat records."""

    def __init__(self, rate_hz: float = 500.0) -> None:
        self.counts, self.status, self.rate_hz = [0] * 6, 0, rate_hz
        self.skip: set[int] = set()
        self.repeat: set[int] = set()
        self.is_streaming = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> RdtServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        sequence, peer = 0, None
        while not self._stop.is_set():
            self._socket.settimeout(1 / self.rate_hz)
            with contextlib.suppress(TimeoutError, ConnectionRefusedError):
                request, peer = self._socket.recvfrom(64)
                magic, command, _ = struct.unpack(">HHI", request)
                assert magic == 0x1234
                self.is_streaming = command == 2
            if not self.is_streaming or peer is None:
                continue
            sequence += 1
            record = struct.pack(">3I6i", sequence, 7 * sequence, self.status, *self.counts)
            for _ in range(0 if sequence in self.skip else 2 if sequence in self.repeat else 1):
                self._socket.sendto(record, peer)
