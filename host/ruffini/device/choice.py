"""Selects the sensor to open among all that answer."""

from __future__ import annotations

import os

from ruffini.device.connection import Connection
from ruffini.device.namesakes import namesakes
from ruffini.device.ports import candidate_ports
from ruffini.errors import NoDeviceError, RuffiniError, SeveralDevicesError

NOTHING_FOUND = (
    "no sensor found: plug one in, or give before the verb its port (--port), or a camera at this computer (--camera)"
)


def connect(port: str | None = None, serial: str | None = None) -> Connection:
    """Open the sensor on `port`, the one with `serial`, or the only one that is connected.

    The arguments default to the environment variables RUFFINI_PORT and RUFFINI_SERIAL.

    Raises
    ------
    NoDeviceError
        No sensor, or none with this serial number; the message lists the answer of each port.
    SeveralDevicesError
        Several sensors and no argument, or several with this serial number; the message lists them and the options.
    """
    port = port or os.environ.get("RUFFINI_PORT")
    serial = serial or os.environ.get("RUFFINI_SERIAL")
    ports = port.split(",") if port else candidate_ports()
    if not ports:
        raise NoDeviceError(NOTHING_FOUND)
    if len(ports) == 1 and serial is None:
        return Connection(ports[0])
    answering: list[Connection] = []
    seen: list[str] = []
    for candidate in ports:
        try:
            connection = Connection(candidate)
        except RuffiniError as error:
            seen.append(f"{candidate} ({error})")
            continue
        seen.append(f"{candidate} (serial {connection.serial_number})")
        if serial is None or connection.serial_number == serial:
            answering.append(connection)
        else:
            connection.close()
    if len(answering) == 1:
        return answering[0]
    for connection in answering:
        connection.close()
    listed = ", ".join(seen)
    if answering:
        same = namesakes([(c.port, c.serial_number) for c in answering])
        if len({c.serial_number for c in answering}) == 1:  # no serial number chooses among them
            raise SeveralDevicesError(same[0])
        text = f"several sensors, choose one with --port or --serial: {listed}"
        raise SeveralDevicesError("; ".join([text, *same]))
    which = "no sensor answers" if serial is None else f"no sensor with serial {serial!r}"
    raise NoDeviceError(f"{which} among: {listed}")
