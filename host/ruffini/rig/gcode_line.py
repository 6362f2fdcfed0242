"""Lines to and from a machine on a serial port."""

from __future__ import annotations

import contextlib
import time
from collections import deque

from ruffini.errors import NoDeviceError

POLL_S = 0.005
MAX_LINE_BYTES = 512


class GcodeLine:
    """One serial port, opened; lines come without their ends."""

    def __init__(self, port: str, baud: int) -> None:
        import serial

        self.port = port
        self._partial = b""
        self._lines: deque[str] = deque()
        try:
            self._serial = serial.Serial(port, baudrate=baud, timeout=POLL_S, write_timeout=2.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise NoDeviceError(f"{port} cannot be opened: {error}: is the machine switched on, and free?") from error

    def send(self, data: bytes) -> None:
        """Raises NoDeviceError where the machine is gone."""
        import serial

        try:
            self._serial.write(data)
        except (serial.SerialException, OSError) as error:
            raise NoDeviceError(f"{self.port}: the machine was unplugged: {error}") from error

    def next_line(self) -> str | None:
        """The next line that came, None after POLL_S without one; raises as `send`."""
        import serial

        if not self._lines:
            try:
                data = self._partial + self._serial.read(self._serial.in_waiting or 1)
            except (serial.SerialException, OSError, TypeError) as error:
                raise NoDeviceError(f"{self.port}: the machine was unplugged: {error}") from error
            *whole, self._partial = data.split(b"\n")
            self._partial = self._partial[-MAX_LINE_BYTES:]
            self._lines.extend(text for line in whole if (text := line.decode("ascii", "replace").strip()))
        return self._lines.popleft() if self._lines else None

    def drain(self, quiet_s: float) -> list[str]:
        """Lines until none came for `quiet_s`."""
        lines, last = [], time.monotonic()
        while time.monotonic() - last < quiet_s:
            line = self.next_line()
            if line is not None:
                lines.append(line)
                last = time.monotonic()
        return lines

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError):
            self._serial.close()
