"""Emulated references with their real protocols: RDT over UDP, packets over serial or TCP, lines, a growing CSV."""

from __future__ import annotations

import contextlib
import csv
import http.server
import os
import pty
import queue
import socket
import struct
import threading
import tty
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ruffini import host_clock
from ruffini.rig.network_cell import MAGIC, RECORD, REQUEST, STREAM, Settings

Array = npt.NDArray[np.float64]

FULL_SCALE = np.array([20.0, 20, 20, 0.5, 0.5, 0.5])
SIGMA = np.array([0.005, 0.005, 0.005, 5e-5, 5e-5, 5e-5])
NOISE = 0.3  # of SIGMA, from reading to reading
PER_COUNT = np.array([1e-6] * 3 + [1e-8] * 3)
POLL_S = 0.05
LOOK_S = 0.002
ERROR_BIT, SATURATED_BIT = 1 << 31, 1 << 17


class Mount(NamedTuple):
    """Mounting of a six-axis reference: rotation from the pad frame (degrees), pad centre in its frame, dead load."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hanging: tuple[float, ...] = (0.0, 0.0, -0.3, 0.001, 0.0, 0.0)

    def reads(self, wrench: Array) -> Array:
        """Its reading for a wrench ON the pad about the pad's centre."""
        turn = Rotation.from_euler("xyz", self.turn_deg, degrees=True)
        force = turn.apply(wrench[:3])
        return np.concatenate([force, turn.apply(wrench[3:]) + np.cross(self.arm_m, force)]) + self.hanging


NO_MOUNT = Mount()
ASKEW = Mount((0.5, -0.8, 4.0), (1.5e-3, -1e-3, 22e-3))
BOLTED, BOLTED_ARM_M = (
    Mount((0.2, -0.3, 0.4), (0.3e-3, -0.2e-3, 22.2e-3)),
    (0.0, 0.0, 22e-3),
)  # and what its drawing says


class EmulatedNetworkCell:
    """A force/torque box on loopback: one record for each wrench that it is told, with noise; can be disturbed."""

    def __init__(self, rate_hz: float, seed: int, mount: Mount = NO_MOUNT) -> None:
        self.settings = Settings(PER_COUNT, "N", "Nm", rate_hz)  # what its page would say
        self.mount, self.gain, self.drift, self.delay_s = mount, np.ones(6), np.zeros(6), 0.0
        self.is_plugged, self.is_saturated = True, False
        self.loses_each = 0  # n: the network loses each n-th record
        self._n_told = 0
        self._rng = np.random.default_rng(seed)
        self._told: queue.SimpleQueue[tuple[float, Array | None]] = queue.SimpleQueue()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.port = int(self._socket.getsockname()[1])
        self._peer: tuple[str, int] | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="force/torque box", daemon=True)

    def __enter__(self) -> EmulatedNetworkCell:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def measure(self, frame: int, wrench: Array) -> None:
        """Set the wrench on the pad. Thread-safe."""
        self._n_told += 1
        is_lost = self.loses_each > 0 and self._n_told % self.loses_each == 0
        if self._peer is not None and self.is_plugged and not self.delay_s and not is_lost:
            host_clock.has_spoken()
        self._told.put((host_clock.now() + self.delay_s, None if is_lost else wrench.copy()))

    def _run(self) -> None:
        sequence = 0
        while not self._stop.is_set():
            try:
                due_s, wrench = self._told.get(timeout=POLL_S)
            except queue.Empty:
                self._listen()
                continue
            host_clock.sleep(max(0.0, due_s - host_clock.now()))
            self._listen()
            if self._peer is not None and self.is_plugged:
                sequence += 1
                if wrench is not None:
                    self._socket.sendto(self._record(sequence, wrench), self._peer)

    def _listen(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError, struct.error):
            while True:
                request, asker = self._socket.recvfrom(64)
                magic, command, _ = REQUEST.unpack(request)
                self._peer = asker if magic == MAGIC and command == STREAM else None

    def _record(self, sequence: int, wrench: Array) -> bytes:
        noise = NOISE * SIGMA * self._rng.normal(size=6)
        counts = np.round(self.gain * (self.mount.reads(wrench) + self.drift + noise) / PER_COUNT).astype(int)
        status = ERROR_BIT | SATURATED_BIT if self.is_saturated else 0
        return RECORD.pack(sequence, sequence, status, *counts.tolist())


PAGE = """<?xml version="1.0"?><netft><cfgcpf>{:g}</cfgcpf><cfgcpt>{:g}</cfgcpt>
<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu><comrdtrate>{:g}</comrdtrate></netft>"""


class EmulatedPage(http.server.ThreadingHTTPServer):
    """The web page of a force/torque box, on loopback."""

    daemon_threads = True

    def __init__(self, rate_hz: float) -> None:
        page = PAGE.format(1 / PER_COUNT[0], 1 / PER_COUNT[3], rate_hz).encode()

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200 if self.path == "/netftapi2.xml" else 404)
                self.end_headers()
                self.wfile.write(page)

            def log_message(self, format: str, *_: object) -> None:
                """Nobody reads it."""

        super().__init__(("127.0.0.1", 0), Handler)

    def __enter__(self) -> EmulatedPage:
        threading.Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()


class EmulatedTextCell:
    """A microcontroller on a pty that prints each force it is told, in `unit`."""

    def __init__(self, seed: int, *, unit: str = "N", per_newton: float = 1.0, noise_n: float = 0.002) -> None:
        self._rng, self._unit, self._per_newton, self._noise_n = np.random.default_rng(seed), unit, per_newton, noise_n
        self._board, self._host = pty.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._board, False)
        self.port = os.ttyname(self._host)

    def __enter__(self) -> EmulatedTextCell:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Disconnect the cable."""
        for descriptor in (self._board, self._host):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def measure(self, frame: int, wrench: Array) -> None:
        """Set the wrench on the pad."""
        pressed_n = -float(wrench[2]) + self._noise_n * self._rng.normal()
        with contextlib.suppress(OSError):  # nobody reads, or the cable was pulled
            os.write(self._board, f"{pressed_n * self._per_newton:.4f} {self._unit}\r\n".encode())
            host_clock.has_spoken()


class EmulatedPacketCell:
    """A force/torque box such as Sunrise's M8128, on a pty or, with `is_tcp`, on loopback.

    It answers commands as the protocol in packet_cell.py says and, while it streams, sends a packet for each wrench
    that it is told. Two threads: one answers, the caller's sends.
    """

    def __init__(self, seed: int, *, is_tcp: bool = False, mount: Mount = NO_MOUNT, noise: float = NOISE) -> None:
        self.mount, self.noise, self.number = mount, noise, 0  # number: of the next packet
        self.refused, self.ignored = set[str](), set[str]()  # commands by name, e.g. "SMPF" of an older box
        self.asked: list[str] = []
        self.is_streaming, self.first = False, b""  # first: bytes sent as soon as it streams
        self.port, self.tcp_port = "", 0
        self._rng = np.random.default_rng(seed)
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._server: socket.socket | None = None
        self._fds: list[int] = []  # its own end of the line, then the host's if that is a pty
        if is_tcp:
            self._server = socket.create_server(("127.0.0.1", 0))
            self._server.setblocking(False)
            self.tcp_port = int(self._server.getsockname()[1])
        else:
            self._fds = [*pty.openpty()]
            tty.setraw(self._fds[1])
            os.set_blocking(self._fds[0], False)
            self.port = os.ttyname(self._fds[1])
        self._thread = threading.Thread(target=self._run, name="force/torque box", daemon=True)

    def __enter__(self) -> EmulatedPacketCell:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.unplug()
        if self._server is not None:
            self._server.close()

    def unplug(self) -> None:
        """Disconnect the cable."""
        with self._lock:
            self._hang_up()

    def _hang_up(self) -> None:
        for descriptor in self._fds:
            os.close(descriptor)
        self._fds, self.is_streaming = [], False

    def measure(self, frame: int, wrench: Array) -> None:
        """Set the wrench on the pad. Thread-safe."""
        if not self.is_streaming:
            return
        values = self.mount.reads(wrench) + self.noise * SIGMA * self._rng.normal(size=6)
        self.send(self.packet(values))
        host_clock.has_spoken()

    def packet(self, values: Array) -> bytes:
        """The next packet, of forces (N) and moments (N m) as they are."""
        data = struct.pack("<6f", *values)
        head = struct.pack(">BBHH", 0xAA, 0x55, len(data) + 3, self.number)
        self.number = (self.number + 1) & 0xFFFF
        return head + data + bytes([sum(data) & 0xFF])

    def send(self, data: bytes) -> None:
        """Send any bytes; they are lost if nobody reads them."""
        with self._lock, contextlib.suppress(OSError):
            if self._fds:
                os.write(self._fds[0], data)

    def _run(self) -> None:
        text, whole = b"", list[bytes]()
        while not self._stop.is_set():
            with self._lock, contextlib.suppress(OSError):  # nothing there yet, or unplugged
                *whole, text = (text + self._received()).split(b"\r\n")
            for line in whole:
                self._answer(line.decode("ascii", "replace"))
            if not whole:
                self._stop.wait(LOOK_S)
            whole = []

    def _received(self) -> bytes:
        """Bytes that came; raises OSError if there are none. A TCP host that is gone makes room for the next."""
        if not self._fds and self._server is not None:
            host, _ = self._server.accept()
            host.setblocking(False)
            self._fds = [host.detach()]
        data = os.read(self._fds[0], 256) if self._fds else b""
        if not data:
            self._hang_up()
        return data

    def _answer(self, command: str) -> None:
        self.asked.append(command)
        name, _, value = command.removeprefix("AT+").partition("=")
        is_known = name in ("SMPF", "SMPR", "SGDM", "GSD") and name not in self.refused
        is_start = name == "GSD" and is_known and value != "STOP"
        if name == "GSD" and is_known:  # before the answer: what is measured after it is sent
            self.is_streaming = is_start
        if name not in self.ignored:
            self.send(f"ACK+{name}={value}${'OK' if is_known else 'ERROR'}\r\n".encode())
        if is_start:
            self.send(self.first)


class EmulatedLogger:
    """Another program that writes each wrench it is told to a CSV, with a clock of its own.

    matrix : (6, 6) N and N m per volt; with it six voltages are written in place of the wrench
    """

    def __init__(
        self, path: Path, seed: int, *, offset_s: float = 0.0, drift: float = 0.0, matrix: Array | None = None
    ) -> None:
        self._path, self._rng = path, np.random.default_rng(seed)
        self._to_columns = np.eye(6) if matrix is None else np.linalg.inv(matrix)
        self.offset_s, self.drift = offset_s, drift
        self._begun_s = host_clock.now()
        self._lock = threading.Lock()
        with path.open("a", newline="") as stream:
            wrench = ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"]
            csv.writer(stream).writerow(["time_s", *(wrench if matrix is None else (f"G{i}" for i in range(6)))])

    def time_of(self, host_s: float) -> float:
        """What its clock shows."""
        return self.offset_s + (host_s - self._begun_s) * (1 + self.drift)

    def measure(self, frame: int, wrench: Array) -> None:
        """Set the wrench on the pad."""
        noisy = wrench + NOISE * SIGMA * self._rng.normal(size=6)
        row = [self.time_of(host_clock.now()), *(self._to_columns @ noisy)]
        with self._lock, self._path.open("a", newline="") as stream:
            csv.writer(stream).writerow([f"{v:.7f}" for v in row])
