"""A serial port or a TCP connection as a stream of bytes in both directions, for devices that are sold with either."""

from __future__ import annotations

import contextlib
import socket
from typing import Protocol

from ruffini.errors import NoDeviceError
from ruffini.patience import PATIENCE

POLL_S = 0.05  # longest wait of one `receive`
CONNECT_S = 3.0 * PATIENCE
SEND_S = 1.0 * PATIENCE
MAX_BYTES = 1 << 16
BITS_PER_BYTE = 10  # 8N1


class ByteLine(Protocol):
    """An open line. One thread."""

    name: str  # where the device is, for messages
    bytes_per_s: float  # most that it carries

    def send(self, data: bytes) -> None:
        """Send all of `data`; raises NoDeviceError if the line is lost."""

    def receive(self) -> bytes:
        """Bytes received since the last call, empty after POLL_S without any; raises as `send`."""

    def close(self) -> None:
        """Close the line. Raises nothing."""


class SerialLine:
    """A serial port, 8N1, for this program alone.

    Raises
    ------
    NoDeviceError
        The port cannot be opened.
    """

    def __init__(self, port: str, baud: int) -> None:
        import serial

        self.name, self.bytes_per_s = f"on {port}", baud / BITS_PER_BYTE
        try:
            self._serial = serial.Serial(port, baudrate=baud, timeout=POLL_S, write_timeout=SEND_S, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise NoDeviceError(f"{port} cannot be opened: {error}: is the device plugged in, and free?") from error

    def send(self, data: bytes) -> None:
        try:
            self._serial.write(data)
        except OSError as error:  # pyserial's errors are of this class
            raise self._lost(error) from error

    def receive(self) -> bytes:
        try:
            return bytes(self._serial.read(self._serial.in_waiting or 1))
        except (OSError, TypeError) as error:  # TypeError: closed meanwhile
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> NoDeviceError:
        return NoDeviceError(f"the device {self.name} was lost: {error}: plug it in, and start again")

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._serial.close()


class TcpLine:
    """A connection to a device on the network.

    Raises
    ------
    NoDeviceError
        Nothing accepts a connection there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.name, self.bytes_per_s = f"at {host}:{port}", float("inf")
        try:
            self._socket = socket.create_connection((host, port), CONNECT_S)
        except (OSError, ValueError) as error:
            raise NoDeviceError(
                f"{host}:{port} cannot be reached: {error}: is the device switched on, at this address, and free?"
            ) from error

    def send(self, data: bytes) -> None:
        try:
            self._socket.settimeout(SEND_S)
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(error) from error

    def receive(self) -> bytes:
        try:
            self._socket.settimeout(POLL_S)
            data = self._socket.recv(MAX_BYTES)
        except TimeoutError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost("it closed the connection")
        return data

    def _lost(self, why: object) -> NoDeviceError:
        return NoDeviceError(f"the device {self.name} was lost: {why}: is it switched on, and free?")

    def close(self) -> None:
        self._socket.close()
