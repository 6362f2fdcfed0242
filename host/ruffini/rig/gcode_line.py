"""Lines to and from a machine on a serial port, and what stages that speak G-code have in common."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Iterator

from ruffini.errors import NoDeviceError, RefusedError, RuffiniError
from ruffini.patience import PATIENCE
from ruffini.rig.stage import Rotary

BAUD = 115200
ANSWER_S, HOME_S = 15.0 * PATIENCE, 120.0 * PATIENCE  # a long move of a machine that does not say "busy" answers late
TURN_S = 60.0 * PATIENCE  # through 120 degrees on both axes, slowly
SEND_S = 2.0 * PATIENCE
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
            self._serial = serial.Serial(port, baudrate=baud, timeout=POLL_S, write_timeout=SEND_S, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise NoDeviceError(f"{port} cannot be opened: {error}: is the machine switched on, and free?") from error

    def send(self, data: bytes) -> None:
        """Raises NoDeviceError where the machine is gone."""
        import serial

        try:
            self._serial.write(data)
        except (serial.SerialException, OSError) as error:
            raise NoDeviceError(
                f"{self.port}: the machine takes no bytes, or was unplugged: {error}: check its power and cable"
            ) from error

    def next_line(self) -> str | None:
        """The next line that came, None after POLL_S without one; raises as `send`."""
        import serial

        if not self._lines:
            try:
                data = self._partial + self._serial.read(self._serial.in_waiting or 1)
            except (serial.SerialException, OSError, TypeError) as error:
                raise NoDeviceError(
                    f"{self.port}: the machine was unplugged: {error}: check its power and cable"
                ) from error
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


class GcodeMachine:
    """One machine; raises NoDeviceError where nothing answers as its firmware does."""

    firmware: str

    def __init__(self, port: str, *, baud: int = BAUD, rotary: Rotary | None = None) -> None:
        self.name = f"{self.firmware} machine on {port}"
        self._rotary, self._is_homed = rotary, False
        self._line = GcodeLine(port, baud)
        try:
            self._greet()
        except BaseException:
            self._line.close()
            raise

    def _greet(self) -> None:
        raise NotImplementedError

    def halt(self) -> None:
        raise NotImplementedError

    def close(self) -> None:
        self._line.close()

    def _need_homed(self) -> None:
        if not self._is_homed:
            raise RefusedError(f"{self.name} is not homed: it does not know where it is: home it first")

    @contextlib.contextmanager
    def _halting(self) -> Iterator[None]:
        """A context that the guard, or Ctrl-C, leaves with the machine standing still, if it knows where it is."""
        try:
            yield
        except BaseException:
            if self._is_homed:
                with contextlib.suppress(RuffiniError):
                    self.halt()
            raise
