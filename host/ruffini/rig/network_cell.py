"""Six-axis force/torque sensors that stream raw data transfer (RDT) records over UDP.

A request is 8 bytes: 0x1234, command, number of samples (0 = without end). A record is 36: two sequences, status,
then Fx Fy Fz Tx Ty Tz in counts, all big endian. Counts per unit, and the units, are in netftapi2.xml of its web page.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import urllib.request
import xml.etree.ElementTree as ElementTree
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError
from ruffini.patience import PATIENCE
from ruffini.rig.reference import Facts, Reading
from ruffini.rig.units import force_factor, torque_factor

Array = npt.NDArray[np.float64]

PORT = 49152
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">3I6i")
MAGIC = 0x1234
STOP, STREAM = 0, 2
ERROR_BIT, SATURATED_BIT = 1 << 31, 1 << 17
HTTP_TIMEOUT_S = 3.0 * PATIENCE
POLL_S = 0.1  # between two looks at how long it has been silent
MAX_PAGE_BYTES = 1 << 20


class Settings(NamedTuple):
    """What the device's own page says: N or N m per count, units by name, records per second."""

    per_count: Array  # (6,)
    force_unit: str
    torque_unit: str
    rate_hz: float


def fetch_settings(host: str, http_port: int = 80) -> Settings:
    """Read a device's configuration page.

    Raises
    ------
    NoDeviceError
        No page there.
    InputError
        It lacks a number, or counts in a unit that is not known.
    """
    url = f"http://{host}:{http_port}/netftapi2.xml"
    try:
        with urllib.request.urlopen(url, timeout=HTTP_TIMEOUT_S) as page:
            return parse_settings(page.read(MAX_PAGE_BYTES), url)
    except OSError as error:
        raise NoDeviceError(f"{url} cannot be read ({error}): is the sensor switched on, at this address?") from error


def parse_settings(page: bytes, url: str) -> Settings:
    """Settings of a configuration page; raises InputError as `fetch_settings`."""
    try:
        tree = ElementTree.fromstring(page)
        text = {e.tag: (e.text or "").strip() for e in tree.iter()}
        counts = [float(text["cfgcpf"])] * 3 + [float(text["cfgcpt"])] * 3
        rate_hz, units = float(text["comrdtrate"]), (text["scfgfu"], text["scfgtu"])
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(f"{url} is no configuration of a force/torque sensor: {error}") from error
    if min(counts) <= 0 or rate_hz <= 0:
        raise InputError(f"{url} says {counts[0]:g} counts per {units[0]} at {rate_hz:g} Hz: both must be above zero")
    factor = [force_factor(units[0])] * 3 + [torque_factor(units[1])] * 3
    return Settings(np.array(factor) / counts, *units, rate_hz)


class NetworkCell:
    """A sensor that streams; `full_scale` and `sigma` (6,) in N and N m from its certificate, forces ON the sensor."""

    def __init__(
        self, host: str, full_scale: Array, sigma: Array, *,
        settings: Settings | None = None, port: int = PORT, name: str = "force/torque sensor",
    ) -> None:  # fmt: skip
        self.settings = settings or fetch_settings(host)
        self._name = f"{name} at {host}"
        self.facts = Facts(self._name, full_scale, sigma, self.settings.rate_hz, self.settings.force_unit)
        self.n_lost = 0
        self._last: int | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, port))
            self._send(STREAM)
        except OSError as error:
            self._socket.close()
            raise NoDeviceError(f"{self._name} cannot be reached: {error}: check the address") from error

    def _send(self, command: int) -> None:
        self._socket.send(REQUEST.pack(MAGIC, command, 0))

    def read(self, timeout_s: float) -> list[Reading]:
        readings: list[Reading] = []
        deadline = host_clock.now() + timeout_s
        while True:
            self._socket.settimeout(min(timeout_s, POLL_S) if not readings else 0)
            try:
                data = self._socket.recv(2048)
            except (TimeoutError, BlockingIOError):
                if readings:
                    return readings
                if host_clock.now() < deadline:
                    continue
                raise NoDeviceError(f"{self._name} sends nothing for {timeout_s:g} s: is it plugged in?") from None
            except OSError as error:
                raise NoDeviceError(f"{self._name} was lost: {error}: is it switched on?") from error
            reading = self._parse(data)
            if reading is not None:
                readings.append(reading)

    def _parse(self, data: bytes) -> Reading | None:
        """One record; None where it is older than one that came before."""
        if len(data) != RECORD.size:
            raise InputError(f"{self._name} sent {len(data)} bytes instead of {RECORD.size}: is this its RDT port?")
        sequence, _, status, *counts = RECORD.unpack(data)
        ahead = 1 if self._last is None else (sequence - self._last) & 0xFFFFFFFF
        if ahead == 0 or ahead > 1 << 31:
            return None
        self.n_lost += ahead - 1
        self._last = sequence
        is_saturated = bool(status & SATURATED_BIT)
        if status & ERROR_BIT and not is_saturated:
            raise NoDeviceError(
                f"{self._name} reports status 0x{status:08x}: look it up in its manual, then restart it"
            )
        wrench = np.array(counts) * self.settings.per_count
        return Reading(host_clock.now(), wrench, is_saturated or bool((abs(wrench) >= self.facts.full_scale).any()))

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._send(STOP)
        self._socket.close()
