"""Two sensors with one serial number: told, and never taken for each other.

A serial number is one sensor's alone, until the card of one board is copied for another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ruffini.device.ports import candidate_ports, place_of, usb_ports

REMEDY = "give one of them a serial number of its own: SERIAL in /etc/ruffini/ruffinid.env on its board"


def namesakes(found: Sequence[tuple[str, str]]) -> list[str]:
    """A sentence for each serial number that several have; `found`: port and serial number of each sensor."""
    ports: dict[str, list[str]] = {}
    for port, serial in found:
        ports.setdefault(serial, []).append(port)
    return [same_serial(serial, each) for serial, each in ports.items() if len(each) > 1]


def same_serial(serial: str, ports: Sequence[str]) -> str:
    """What to say of sensors with one serial number."""
    return f"{' and '.join(ports)} have the same serial number {serial}: choose by --port, and {REMEDY}"


def usb_namesakes(port: str, serial: str) -> list[str]:
    """Ports of other USB devices with the serial number of the sensor on `port`; they need not be free to be seen."""
    own = _device(place_of(port))
    others = {_device(i.location): i.device for i in reversed(usb_ports()) if i.serial_number == serial and i.location}
    return sorted(port for device, port in others.items() if device != own)


def _device(place: str) -> str:
    """Of a place on USB without the interface: a device with two pads has two."""
    return place.partition(":")[0]


class Whereabouts:
    """Where a sensor is, and where others are beside it."""

    def __init__(self, port: str) -> None:
        self._own, self._others = place_of(port), set[str]()
        self.look_around()

    def look_around(self) -> None:
        """Remember who else is there."""
        self._others |= {place_of(port) for port in candidate_ports()} - {self._own}

    def doubt(self, port: str, before: Any, now: Any) -> str:
        """Why the sensor with the right serial number on `port` may be another one; empty: it is the same.

        Parameters
        ----------
        before, now : what HELLO said before the line was lost, and says on `port`. A session is one start of one
            sensor. Whoever was started again is known by its place, or because nobody else was ever there.
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
