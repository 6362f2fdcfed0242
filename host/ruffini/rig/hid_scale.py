"""A postal or kitchen scale that reports its weight over USB HID, through Linux's /dev/hidraw.

A data report (USB HID Point of Sale Usage Tables 1.02, weighing devices): identifier, status, unit, decimal exponent
(signed), weight (16 bits, little-endian). No such scale has been tried yet.
"""

from __future__ import annotations

import os
import select
import struct
import time
from pathlib import Path

from ruffini import host_clock
from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.units import force_factor

REPORT = struct.Struct("<BBBbH")
DATA_REPORT = 3  # identifier
USAGE_PAGE = b"\x05\x8d"  # of weighing devices, at the beginning of a report descriptor
# Of their units the name of ours, and its size in ours.
UNITS = {
    1: ("g", 1e-3),
    2: ("g", 1.0),
    3: ("kg", 1.0),
    11: ("oz", 1.0),
    12: ("lb", 1.0),
}
ZERO, MOVING, STABLE, UNDER_ZERO, OVER_LIMIT = 2, 3, 4, 5, 6  # status
FAULTS = {1: "reports a fault", 7: "asks to be calibrated", 8: "asks to be set to zero"}
RATE_HZ = 2.0  # stated: slow ones report twice a second
FULL_SCALE_N = 50.0
SYS = Path("/sys/class/hidraw")
MAX_EXPONENT = 6  # either way


def parse_report(report: bytes) -> tuple[float, bool] | None:
    """Newtons that rest on the scale, and whether that is beyond its range; None if the report tells no weight.

    Raises
    ------
    InputError
        Another unit than g, kg, oz, lb.
    RefusedError
        The scale says that it does not weigh.

    Examples
    --------
    >>> parse_report(bytes([3, 4, 2, 0, 100, 0]))  # 100 g
    (0.980665, False)
    """
    if len(report) < REPORT.size or report[0] != DATA_REPORT:
        return None
    _, status, unit, exponent, weight = REPORT.unpack_from(report)
    if status in FAULTS:
        raise RefusedError(f"the scale {FAULTS[status]}: see its manual, then go on")
    if status not in (ZERO, MOVING, STABLE, UNDER_ZERO, OVER_LIMIT):
        return None
    if unit not in UNITS:
        raise InputError(f"the scale weighs in unit {unit} of the HID tables: set it to grams")
    if abs(exponent) > MAX_EXPONENT:
        return None
    name, scale = UNITS[unit]
    force_n = weight * 10.0**exponent * scale * force_factor(name)
    return (-force_n if status == UNDER_ZERO else force_n), status == OVER_LIMIT


def find_scales(sys: Path = SYS) -> list[str]:
    """Paths of the weighing devices that are plugged in."""
    found = []
    for node in sorted(sys.glob("hidraw*")):
        try:
            descriptor = (node / "device" / "report_descriptor").read_bytes()
        except OSError:  # unplugged meanwhile
            continue
        if descriptor.startswith(USAGE_PAGE):
            found.append(f"/dev/{node.name}")
    return found


class HidScale:
    """A scale on /dev/hidrawN; the weight on it presses the pad.

    Raises
    ------
    NoDeviceError
        It cannot be opened.
    """

    def __init__(self, path: str, sigma_n: float) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except PermissionError as error:
            raise NoDeviceError(
                f"{path} cannot be opened: no permission: allow it with `sudo chmod a+r {path}`, or type the weights"
            ) from error
        except (OSError, ValueError) as error:
            raise NoDeviceError(f"{path} cannot be opened ({error}): is the scale plugged in, and on?") from error
        self._path = path
        self.facts = Facts.of_one_axis(f"scale on {path}", FULL_SCALE_N, sigma_n, RATE_HZ, "g")

    def read(self, timeout_s: float) -> list[Reading]:
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = deadline - time.monotonic()
            if left_s <= 0 or not select.select([self._file], [], [], left_s)[0]:
                raise NoDeviceError(f"{self._path}: no weight for {timeout_s:g} s: is the scale switched on?")
            try:
                report = os.read(self._file, REPORT.size)  # one report; the end of a longer one is dropped
            except BlockingIOError:
                continue
            except OSError as error:
                raise NoDeviceError(f"{self._path}: the scale was unplugged: {error}") from error
            if not report:
                raise NoDeviceError(f"{self._path}: the scale was unplugged")
            if (weighed := parse_report(report)) is not None:
                force_n, is_over = weighed
                return [Reading(host_clock.now(), pressing(-force_n), is_over)]

    def close(self) -> None:
        os.close(self._file)
