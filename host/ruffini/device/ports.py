"""Serial ports: finding those that may be sensors, and opening one exclusively."""

from __future__ import annotations

import os
from typing import Any

from ruffini.device import port_holder
from ruffini.device.pty_name import KnownPort
from ruffini.errors import NoDeviceError

WRITE_TIMEOUT_S = 5.0  # an overloaded kernel can block a pty for more than two seconds


def open_port(port: str, known: KnownPort | None = None) -> Any:
    """Open a serial port exclusively; reads wait at most 20 ms.

    Parameters
    ----------
    known : the port's identity when it was open before, None for the first time.

    Raises
    ------
    NoDeviceError
        The port is missing or busy, or its name now belongs to another program's pseudo-terminal.
    """
    import serial

    if known is not None and known.port == port and known.is_stale():
        raise NoDeviceError(f"{port} is gone, and its name may be another program's by now: start the sensor again")
    try:
        opened = serial.Serial(port, baudrate=115200, timeout=0.02, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        port_holder.make_exclusive(opened, port)
        return opened
    except (serial.SerialException, OSError, ValueError) as error:
        who = ", ".join(port_holder.holders(port)) or "another program"
        is_busy = _is_busy(str(error).replace(port, ""))  # a name may have such words in it
        reason = f"is busy: {who} has it open: end that first" if is_busy else f"cannot be opened: {error}"
        raise NoDeviceError(f"{port} {reason}") from error


def _is_busy(text: str) -> bool:
    text = text.lower()
    return "busy" in text or "lock" in text or "resource temporarily unavailable" in text


def usb_ports() -> list[Any]:
    """Serial ports whose USB product or manufacturer contains "ruffini", as pyserial describes them."""
    from serial.tools import list_ports

    return [p for p in list_ports.comports() if "ruffini" in f"{p.product or ''} {p.manufacturer or ''}".lower()]


def candidate_ports() -> list[str]:
    """Serial ports that may be sensors: USB devices whose product or manufacturer contains "ruffini"."""
    return sorted(p.device for p in usb_ports())


def place_of(port: str) -> str:
    """The location of a sensor that survives replugging: its USB socket, or the port's name for other lines.

    A link such as /dev/ruffini/SERIAL may point elsewhere after replugging.
    """
    real = os.path.realpath(port)
    return next((str(p.location) for p in usb_ports() if p.location and p.device == real), port)
