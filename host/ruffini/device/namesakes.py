"""Detects two sensors with the same serial number, so that one is never taken for the other.

Serial numbers are unique until the SD card of one board is copied for another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ruffini.device.ports import candidate_ports, place_of, usb_ports

REMEDY = "give one of them a serial number of its own: SERIAL in /etc/ruffini/ruffinid.env on its board"


def namesakes(found: Sequence[tuple[str, str]]) -> list[str]:
    """A message for each serial number shared by several sensors; `found` has port and serial number of each sensor."""
    ports: dict[str, list[str]] = {}
    for port, serial in found:
        ports.setdefault(serial, []).append(port)
    return [same_serial(serial, each) for serial, each in ports.items() if len(each) > 1]


def same_serial(serial: str, ports: Sequence[str]) -> str:
    """The message about sensors that share a serial number."""
    return f"{' and '.join(ports)} have the same serial number {serial}: choose by --port, and {REMEDY}"


def usb_namesakes(port: str, serial: str) -> list[str]:
    """Ports of other USB devices with the serial number of the sensor on `port`, including busy ones."""
    own = _device(place_of(port))
    others = {_device(i.location): i.device for i in reversed(usb_ports()) if i.serial_number == serial and i.location}
    return sorted(port for device, port in others.items() if device != own)


def _device(place: str) -> str:
    """A USB location without its interface, since a device with two pads has two interfaces."""
    return place.partition(":")[0]


class Whereabouts:
    """The USB location of a sensor and those of the sensors beside it."""

    def __init__(self, port: str) -> None:
        self._own, self._others = place_of(port), set[str]()
        self.look_around()

    def look_around(self) -> None:
        """Add the sensors that are connected now."""
        self._others |= {place_of(port) for port in candidate_ports()} - {self._own}

    def doubt(self, port: str, before: Any, now: Any) -> str:
        """Why the sensor on `port` may be another one with the same serial number; empty if it is the same.

        Parameters
        ----------
        before, now : HELLO before the line was lost, and on `port` now. A session is one start of one sensor; a
            restarted sensor is recognised by its location, or because no other sensor was ever seen.
        """
        if now.session_id == before.session_id:
            return ""
        place = place_of(port)
        if place in self._others:
            return "was there before, beside it"
        if [s.board for s in now.sensors] != [s.board for s in before.sensors]:
            return "is another board"
        if place == self._own:
            return ""
        if self._others:
            return "was started again in another place, and there are other sensors"
        return "" if _calibrations(now) == _calibrations(before) else "has another place and another calibration"


def _calibrations(hello: Any) -> list[bytes]:
    return [s.calibration.sha256 for s in hello.sensors]
