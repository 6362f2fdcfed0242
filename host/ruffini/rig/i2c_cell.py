"""FX29 compression load cells on an I2C bus.

An empty write asks for a measurement; 8.4 ms later two bytes hold two status bits (0 fresh, 1 command mode,
2 read before, 3 fault) and 14 bits of force: 1000 counts without load, 15000 at full scale.
"""

from __future__ import annotations

import contextlib
import re
import time
from typing import Any, NamedTuple

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.units import POUND_N

ADDRESSES = (0x28, 0x36, 0x46, 0x48, 0x51)  # by the digit behind FX29K
ZERO_COUNTS, SPAN_COUNTS = 1000, 14000
BROKEN_COUNTS = 200  # a cell that nothing pulls at never reads as little
FRESH, STALE = 0, 2
MEASUREMENT_S = 0.0085
RATE_HZ = 100.0
LINEARITY = 0.01  # limits of error, of full scale, by the data sheet
TO_SIGMA = 3**-0.5  # of limits within which an error is spread evenly
PART = re.compile(r"FX29[KJ]([0-4])-\w+-(\d{4})-([LN])", re.IGNORECASE)


class Part(NamedTuple):
    """What a part number says."""

    address: int
    full_scale_n: float
    unit: str


def parse_part(number: str) -> Part:
    """Address and range of a part number such as FX29K0-040B-0010-L: 10 pounds (L) or newtons (N) at 0x28.

    Raises
    ------
    InputError
        It is none of a cell with I2C.
    """
    match = PART.fullmatch(number.strip())
    if match is None:
        raise InputError(f"{number!r} is no part number of an FX29 with I2C: copy it from the cell, "
                         "e.g. FX29K0-040B-0010-L")  # fmt: skip
    unit = "lb" if match[3].upper() == "L" else "N"
    return Part(ADDRESSES[int(match[1])], int(match[2]) * (POUND_N if unit == "lb" else 1.0), unit)


class I2cCell:
    """One cell; `bus` is a bus number, or an open bus such as smbus2.SMBus."""

    def __init__(self, part_number: str, bus: Any = 1, *, sigma_n: float | None = None) -> None:
        self.part = parse_part(part_number)
        self._name = f"FX29 at 0x{self.part.address:02x}"
        self._bus = _open(bus) if isinstance(bus, int) else bus
        scale = self.part.full_scale_n
        self.facts = Facts.of_one_axis(
            self._name, scale, LINEARITY * TO_SIGMA * scale if sigma_n is None else sigma_n, RATE_HZ, self.part.unit
        )

    def read(self, timeout_s: float) -> list[Reading]:
        deadline = time.monotonic() + timeout_s
        while True:
            status, counts = self._measure()
            if status == FRESH:
                return [self._reading(counts)]
            if status != STALE:
                raise NoDeviceError(f"{self._name} reports {'a fault' if status == 3 else 'command mode'}: "
                                    "check its supply, then plug it in again")  # fmt: skip
            if time.monotonic() > deadline:
                raise NoDeviceError(f"{self._name} measures nothing new for {timeout_s:g} s: plug it in again")

    def _measure(self) -> tuple[int, int]:
        from smbus2 import i2c_msg

        request, answer = i2c_msg.write(self.part.address, []), i2c_msg.read(self.part.address, 2)
        try:
            self._bus.i2c_rdwr(request)
            time.sleep(MEASUREMENT_S)
            self._bus.i2c_rdwr(answer)
        except OSError as error:
            raise NoDeviceError(f"{self._name} does not answer ({error.strerror or error}): "
                                "is it plugged in, and is it this part number?") from error  # fmt: skip
        high, low = bytes(answer)
        return high >> 6, (high & 0x3F) << 8 | low

    def _reading(self, counts: int) -> Reading:
        if counts < BROKEN_COUNTS:
            raise NoDeviceError(f"{self._name} reads {counts} counts, far below its zero of {ZERO_COUNTS}: "
                                "a wire is loose or the cell is broken")  # fmt: skip
        pressed_n = (counts - ZERO_COUNTS) / SPAN_COUNTS * self.part.full_scale_n
        return Reading(host_clock.now(), pressing(-pressed_n), counts >= ZERO_COUNTS + SPAN_COUNTS)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._bus.close()


def _open(number: int) -> Any:
    from smbus2 import SMBus

    try:
        return SMBus(number)
    except OSError as error:
        raise NoDeviceError(f"/dev/i2c-{number} cannot be opened ({error.strerror}): is I2C switched on?") from error
