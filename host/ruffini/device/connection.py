"""One device on one port: who it is, what it streams, commands and flashing."""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from ruffini.errors import NoDeviceError, RefusedError, RuffiniError, SeveralDevicesError, VerifyError
from ruffini.wire import Decoder, Frame, Schema, encode_message

HELLO_TIMEOUT_S = 2.0
REPLY_TIMEOUT_S = 2.0
COMMIT_TIMEOUT_S = 30.0  # proof, fsync and read-back of a large table on a slow medium
RETRIES = 3
CHUNK_BYTES = 3072
TRIAL_POLL_S = 0.1
TRIAL_STALL_S = 10.0  # on trial without a frame: the camera stands still
SILENCE_S = 5.0  # without a frame: the camera stands still
MAX_BACKLOG = 4096  # messages kept while a command waits for its reply
DEVICE = 255
FLASH_DURABLE, FLASH_ACTIVE = 3, 4  # FlashState of the schema
YOUNG_TYPES = ("learned",)  # that a device in use may not know yet


class Connection:
    """An open sensor; use as a context manager.

    Parameters
    ----------
    port : str
        Serial device, e.g. /dev/ttyACM0 or a pty.

    Raises
    ------
    NoDeviceError
        The port is missing or busy, or nothing answers HELLO on it.
    """

    def __init__(self, port: str, *, hello_timeout_s: float = HELLO_TIMEOUT_S) -> None:
        import serial

        self.port = port
        try:
            self._serial = serial.Serial(port, baudrate=115200, timeout=0.02, write_timeout=2.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            reason = "busy: another program has it open" if _is_busy(error) else f"cannot be opened: {error}"
            raise NoDeviceError(f"{port} is {reason}" if "busy" in reason else f"{port} {reason}") from error
        self.schema = Schema.own()
        self.decoder = Decoder()
        self.messages: deque[tuple[Frame, Any]] = deque(maxlen=MAX_BACKLOG)
        self.raw_sink: Callable[[bytes], None] | None = None
        self._sequence = 0
        self._request_id = int.from_bytes(os.urandom(3), "little") + 1
        try:
            self.hello = self._say_hello(hello_timeout_s)
            if self.hello.schema_sha256 != self.schema.sha256:
                self.schema = self._fetch_schema()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError):
            self._serial.close()

    @property
    def serial_number(self) -> str:
        return str(self.hello.device_serial)

    # ---- receiving ----------------------------------------------------------------------------

    def _read(self) -> None:
        """Decode what has arrived (waits at most 20 ms) into `messages`."""
        import serial

        try:
            data = self._serial.read(max(self._serial.in_waiting, 1))
        except (serial.SerialException, OSError, TypeError) as error:
            raise NoDeviceError(f"{self.port}: the line was lost: {error}") from error
        if self.raw_sink is not None and data:
            self.raw_sink(data)
        for frame in self.decoder.feed(data):
            message = self.schema.decode(frame.type, frame.payload)
            if message is not None:
                self.messages.append((frame, message))

    def stream(self, *, timeout_s: float | None = None) -> Iterator[tuple[Frame, Any]]:
        """Messages as they come; ends after `timeout_s` without one (never when None)."""
        last = time.monotonic()
        while True:
            while self.messages:
                last = time.monotonic()
                yield self.messages.popleft()
            self._read()
            if timeout_s is not None and not self.messages and time.monotonic() - last > timeout_s:
                return

    def _wait_for(self, type_name: str, timeout_s: float, accept: Callable[[Any], bool]) -> Any | None:
        wanted = self.schema.type_numbers[type_name]
        deadline = time.monotonic() + timeout_s
        kept: deque[tuple[Frame, Any]] = deque(maxlen=MAX_BACKLOG)
        try:
            while time.monotonic() < deadline:
                while self.messages:
                    frame, message = self.messages.popleft()
                    if frame.type == wanted and accept(message):
                        return message
                    kept.append((frame, message))
                self._read()
            return None
        finally:
            kept.extend(self.messages)  # the oldest go where the backlog is full
            self.messages = kept

    # ---- sending ------------------------------------------------------------------------------

    def _write(self, data: bytes) -> None:
        import serial

        try:
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise NoDeviceError(f"{self.port}: nobody takes what is sent: is ruffinid running?") from error
        except (serial.SerialException, OSError) as error:
            raise NoDeviceError(f"{self.port}: the line was lost: {error}") from error

    def _send(self, type_name: str, payload: bytes = b"") -> None:
        number = self.schema.type_numbers[type_name]
        self._write(encode_message(number, payload, sensor=DEVICE, sequence=self._sequence))
        self._sequence += 1

    def _say_hello(self, timeout_s: float) -> Any:
        self._write(b"\0")  # end whatever half frame is in the device's buffer
        # Where a slow device was asked more than once it answered more than once: those answers are of before.
        number = self.schema.type_numbers["HELLO"]
        self.messages = deque((m for m in self.messages if m[0].type != number), maxlen=MAX_BACKLOG)
        for _ in range(RETRIES):
            self._send("HELLO")
            hello = self._wait_for("HELLO", timeout_s / RETRIES, lambda m: True)
            if hello is not None:
                return hello
        raise NoDeviceError(f"{self.port}: nothing answers HELLO: is ruffinid running, and is it this port?")

    def _fetch_schema(self) -> Schema:
        for _ in range(RETRIES):
            self._send("SCHEMA")
            message = self._wait_for("SCHEMA", REPLY_TIMEOUT_S, lambda m: True)
            if message is not None:
                return Schema(message.file_descriptor_set)
        raise NoDeviceError(f"{self.port}: the device does not serve its schema")

    def command(self, *, timeout_s: float = REPLY_TIMEOUT_S, **action: Any) -> Any:
        """Send one command, e.g. command(zero={"n_frames": 0}); retried under the same request id.

        Raises
        ------
        RefusedError, VerifyError, RuffiniError
            What the device says against it.
        """
        self._request_id = self._request_id % 0xFFFFFFFF + 1
        request = self._request_id
        try:
            payload = self.schema.new("Command", request_id=request, **action).SerializeToString()
        except ValueError as error:  # a device that is older than this host brought its own schema
            raise RefusedError(f"{self.port}: this firmware knows no {next(iter(action))}: update it") from error
        for _ in range(RETRIES):
            self._send("COMMAND", payload)
            reply = self._wait_for("REPLY", timeout_s, lambda m: m.request_id == request)
            if reply is not None:
                return reply
        raise NoDeviceError(f"{self.port}: no reply to {next(iter(action))} after {RETRIES} tries")

    def checked(self, **action: Any) -> Any:
        """`command`, and an exception unless the device says OK."""
        reply = self.command(**action)
        if reply.code:
            raise RefusedError(f"{self.port}: {reply.text}")
        return reply

    def subscribe(self, **every: int) -> None:
        """Ask for each n-th message of a type, e.g. subscribe(wrench=1, field=2); replaces what was asked before.

        `learned` is passed over where the device is older than that message.
        """
        numbers = self.schema.type_numbers
        every = {name: n for name, n in every.items() if name.upper() in numbers or name not in YOUNG_TYPES}
        self.checked(
            subscribe={"subscriptions": [{"type": numbers[name.upper()], "every": n} for name, n in every.items()]}
        )

    def flash(
        self,
        data: bytes,
        progress: Callable[[float], None] = lambda _: None,
        say: Callable[[str], None] = lambda _: None,
    ) -> Any:
        """Upload a calibration file; returns when the device says that it is in force for good.

        The device names the next byte that it wants, so a lost chunk is sent again and an interrupted
        upload goes on where it was. A new calibration is on trial until it has shown good frames; `say` is told how far
        that is.

        Raises
        ------
        RefusedError
            Wrong board, wrong key, a table that the device cannot prove, or a trial without good frames: it goes
            on with what it had before.
        NoDeviceError
            The line was lost, or the camera gives no frames for the trial.
        VerifyError
            What arrived or was stored is not what was sent.
        """
        reply = self.checked(flash_begin={"size_bytes": len(data), "sha256": hashlib.sha256(data).digest()})
        offset, stuck = reply.next_offset, 0
        while offset < len(data):
            reply = self.command(flash_chunk={"offset": offset, "data": data[offset : offset + CHUNK_BYTES]})
            stuck = stuck + 1 if reply.next_offset <= offset else 0
            if stuck > RETRIES:
                raise RefusedError(f"{self.port}: the upload does not go on: {reply.text}")
            offset = reply.next_offset
            progress(offset / len(data))
        reply = self._in_force(flash_commit={})
        if reply.flash_state == FLASH_DURABLE:
            reply = self._end_of_trial(hashlib.sha256(data).digest(), say)
        if self.hello.sensors[0].calibration.sha256 != hashlib.sha256(data).digest():
            raise VerifyError(f"{self.port}: the calibration in force is not the one that was sent")
        return reply

    def undo_flash(self) -> Any:
        """Put the calibration in force that was so before the last flash; the device has kept it. Undoes itself.

        Raises
        ------
        RefusedError
            There was none before, or it no longer fits.
        VerifyError
            The medium failed, or the device goes on with what it had.
        """
        before = self.hello.sensors[0].calibration.sha256
        reply = self._in_force(flash_undo={})
        if self.hello.sensors[0].calibration.sha256 == before:
            raise VerifyError(f"{self.port}: the calibration in force is still the one that was to be undone")
        return reply

    def _end_of_trial(self, sha256: bytes, say: Callable[[str], None]) -> Any:
        """The reply that ends the trial of a calibration, and HELLO as it is then."""
        n_frames, since, said = 0, time.monotonic(), ""
        while (reply := self.command(flash_query={"sha256": sha256})).flash_state == FLASH_DURABLE:
            if reply.value != n_frames:
                n_frames, since = reply.value, time.monotonic()
            elif time.monotonic() - since > TRIAL_STALL_S:
                raise NoDeviceError(
                    f"{self.port}: the calibration is stored, but the camera gives no frames to try it on: "
                    f"see why, and flash again; until then a restart goes back to what was before"
                )
            if reply.text != said:
                say(said := reply.text)
            time.sleep(TRIAL_POLL_S)
        if reply.code:
            raise RefusedError(f"{self.port}: {reply.text}")
        if reply.text:  # in force, but not as it should be
            raise VerifyError(f"{self.port}: {reply.text}")
        self.hello = self._say_hello(HELLO_TIMEOUT_S)
        return reply

    def _in_force(self, **action: Any) -> Any:
        """A command that ends with a calibration in force, on trial or for good, and HELLO as it is then."""
        reply = self.command(**action, timeout_s=COMMIT_TIMEOUT_S)
        if reply.code == self._reply_code("REPLY_STORAGE"):
            raise VerifyError(f"{self.port}: {reply.text}")
        if reply.code or reply.flash_state not in (FLASH_DURABLE, FLASH_ACTIVE):
            raise RefusedError(f"{self.port}: {reply.text}")
        self.hello = self._say_hello(HELLO_TIMEOUT_S)
        return reply

    def _reply_code(self, name: str) -> int:
        return int(self.schema._pool.FindEnumTypeByName("ruffini.ReplyCode").values_by_name[name].number)


def _is_busy(error: Exception) -> bool:
    text = str(error).lower()
    return "busy" in text or "lock" in text or "resource temporarily unavailable" in text


def candidate_ports() -> list[str]:
    """Serial ports that may be sensors: USB devices whose product or maker says ruffini."""
    from serial.tools import list_ports

    return sorted(
        p.device for p in list_ports.comports() if "ruffini" in f"{p.product or ''} {p.manufacturer or ''}".lower()
    )


def connect(port: str | None = None, serial: str | None = None) -> Connection:
    """Open the sensor on `port`, the one with `serial`, or the only one there is.

    RUFFINI_PORT and RUFFINI_SERIAL stand in for arguments that are not given.

    Raises
    ------
    NoDeviceError
        None, or none with this serial number; the text says what each port answered.
    SeveralDevicesError
        Several and no choice; the text lists them and names the option.
    """
    port = port or os.environ.get("RUFFINI_PORT")
    serial = serial or os.environ.get("RUFFINI_SERIAL")
    ports = port.split(",") if port else candidate_ports()
    if not ports:
        raise NoDeviceError("no sensor found: plug one in, or name its port with --port")
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
        raise SeveralDevicesError(f"several sensors, choose one with --port or --serial: {listed}")
    which = "no sensor answers" if serial is None else f"no sensor with serial {serial!r}"
    raise NoDeviceError(f"{which} among: {listed}")
