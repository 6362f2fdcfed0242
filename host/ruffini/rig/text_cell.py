"""A microcontroller that prints one number a line over serial, as sketches for the HX711 do."""

from __future__ import annotations

import contextlib
import re
import time
from typing import NamedTuple

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.units import NEWTONS, force_factor

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
UNIT_AFTER = re.compile(r"\s*([A-Za-z]+)")
OVERFLOW = re.compile(r"\b(ovf|ol|overflow|saturat\w*|nan|inf)\b", re.IGNORECASE)
START_S = 4.0  # opening the port resets most boards
MAX_STRANGE_LINES = 5  # in a row, once a number has come
MAX_LINE_BYTES = 200


class Line(NamedTuple):
    """One line as understood."""

    value: float
    unit: str | None
    is_overflow: bool = False


def parse_line(text: str) -> Line | None:
    """Last number of a line and the unit behind it; None where there is no number.

    Examples
    --------
    >>> parse_line("weight: 12.5 g")
    Line(value=12.5, unit='g', is_overflow=False)
    """
    if OVERFLOW.search(text):
        return Line(0.0, None, True)
    found = list(NUMBER.finditer(text))
    if not found:
        return None
    after = UNIT_AFTER.match(text, found[-1].end())
    unit = after[1].lower() if after and after[1].lower() in NEWTONS else None
    return Line(float(found[-1][0]), unit)


class TextCell:
    """Numbers in `unit`, positive when pressed (`is_inverted` otherwise), up to `full_scale_n`.

    Raises
    ------
    NoDeviceError
        The port cannot be opened, or no number comes.
    """

    def __init__(
        self, port: str, unit: str, full_scale_n: float, sigma_n: float, *,
        baud: int = 115200, rate_hz: float = 10.0, is_inverted: bool = False,
    ) -> None:  # fmt: skip
        import serial

        self._factor = force_factor(unit) * (1 if is_inverted else -1)
        self.facts = Facts.of_one_axis(f"cell on {port}", full_scale_n, sigma_n, rate_hz, unit)
        try:
            self._serial = serial.Serial(port, baudrate=baud, timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise NoDeviceError(f"{port} cannot be opened: {error}: is the board plugged in, and free?") from error
        self._port, self._partial, self._n_strange, self._has_started = port, b"", 0, False

    def read(self, timeout_s: float) -> list[Reading]:
        wait_s = timeout_s if self._has_started else max(timeout_s, START_S)
        deadline = host_clock.now() + wait_s
        while True:
            readings = [r for line in self._lines() if (r := self._reading(line)) is not None]
            if readings:
                self._has_started = True
                return readings
            if host_clock.now() > deadline:
                raise NoDeviceError(
                    f"{self._port}: no number for {wait_s:g} s: is the board running, and the baud rate right?"
                )
            time.sleep(0.002)

    def _lines(self) -> list[str]:
        import serial

        try:
            data = self._partial + self._serial.read(self._serial.in_waiting or 1)
        except (serial.SerialException, OSError, TypeError) as error:
            raise NoDeviceError(f"{self._port}: the board was unplugged: {error}") from error
        *whole, self._partial = data.split(b"\n")
        self._partial = self._partial[-MAX_LINE_BYTES:]
        return [line.decode("ascii", "replace").strip() for line in whole]

    def _reading(self, text: str) -> Reading | None:
        line = parse_line(text)
        if line is None or not text.isprintable():
            self._n_strange += bool(text) and self._has_started
            if self._n_strange > MAX_STRANGE_LINES:
                raise InputError(f"{self._port}: {text!r} has no number: the board must print one number a line")
            return None
        self._n_strange = 0
        if line.unit is not None and NEWTONS[line.unit] != force_factor(self.facts.unit):
            raise InputError(f"{self._port} counts in {line.unit} ({text!r}), not in {self.facts.unit}: "
                             f"give unit = '{line.unit}' in [reference]")  # fmt: skip
        force_n = self._factor * line.value
        limit_n = self.facts.full_scale[2]
        return Reading(host_clock.now(), pressing(force_n), line.is_overflow or abs(force_n) >= limit_n)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._serial.close()
