"""A connection to one device on one port: identity, stream, commands and flashing."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from ruffini.device import flashing
from ruffini.device.backlog import Backlog
from ruffini.device.device_clock import DeviceClock
from ruffini.device.line import DEVICE
from ruffini.device.line_gap import LineGap
from ruffini.device.namesakes import REMEDY, Whereabouts
from ruffini.device.ports import candidate_ports, open_port
from ruffini.device.pty_name import KnownPort
from ruffini.device.writer import Writer
from ruffini.errors import LineLostError, NoDeviceError, RefusedError, RuffiniError
from ruffini.patience import PATIENCE
from ruffini.wire import Decoder, Frame, Schema, encode_message
from ruffini.wire.damage import DamageWatch

BUSY_HELLO_S = 20.0  # a busy device answers late: it is asked for so long while it sends messages
HELLO_TIMEOUT_S = min(2.0 * PATIENCE, BUSY_HELLO_S)
REPLY_TIMEOUT_S, TRIES = 0.5, 12
RETRIES = 3
REOPEN_PAUSE_S = 0.02
REOPEN_HELLO_S = 0.6  # a sensor that was just plugged in answers, or the next try will
SILENCE_S = 5.0 * PATIENCE  # without a frame: the camera has stalled
IMAGE_S = 3 * SILENCE_S  # without an image, which takes seconds on a slow line
MAX_TURN_S = 0.5  # an iteration of a stream waits 20 ms for bytes; a longer one was suspended or did other work
MAX_ASKED = 4096  # pending time exchanges
YOUNG_TYPES = ("learned", "residual", "features")  # message types that older firmware lacks
DAMAGED = (
    "two frames arrived damaged within six minutes: do not use these forces for control until the cable is fixed "
    "(one damaged frame in 4 billion passes as good)"
)
FIRST_TIMES, FIRST_TIME_S, TIME_S = 8, 0.02, 1.0  # time exchanges: number and period at first, then the period
ASK_AGAIN = 0  # request id of the reply to a damaged command


class Connection:
    """An open sensor; use as a context manager.

    Parameters
    ----------
    port : str
        Serial device, e.g. /dev/ttyACM0 or a pty.

    Raises
    ------
    NoDeviceError
        The port is missing or busy, or no device answers HELLO on it.
    """

    def __init__(self, port: str, *, hello_timeout_s: float = HELLO_TIMEOUT_S) -> None:
        self.port, self._first_port = port, port
        self._serial = open_port(port)
        self._known = KnownPort(port)
        self._whereabouts = Whereabouts(port)
        self._subscribed: dict[str, int] = {}
        self.schema = Schema.own()
        self.decoder = Decoder()
        self.messages = Backlog()  # messages that arrive while a command waits for its reply
        self.raw_sink: Callable[[bytes], None] | None = None
        self.n_retries = 0  # commands that were sent again
        self.damage = DamageWatch()
        self.on_damage: Callable[[str], None] = lambda _: None  # called when the line becomes too bad for control
        # Called every 20 ms while a stream waits, with True if the line is open; may raise to end the stream.
        self.on_turn: Callable[[bool], None] = lambda _: None
        self.resumed_s = 0.0  # monotonic time at which the line was last reopened
        self.clock = DeviceClock()
        self._asked: dict[int, int] = {}  # start of each pending time exchange by its token, ns
        self._time_token, self._asked_s = 0, 0.0
        self._writer = Writer()
        self._sequence = 0
        self._request_id = int.from_bytes(os.urandom(3), "little") + 1
        try:
            self.hello = self._say_hello(hello_timeout_s, patience_s=BUSY_HELLO_S)
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
        """Release the lease and close the port."""
        if self._writer.has_lease:
            self._writer.has_lease = False
            with contextlib.suppress(OSError, RuffiniError):
                fields = {"request_id": 0xFFFFFFFF, "holder": self._writer.holder, "lease": {"release": True}}
                self._send(*self._writer.wrap(self, "lease", self.schema.new("Command", **fields).SerializeToString()))
        with contextlib.suppress(OSError):
            self._serial.close()

    def resume(self, timeout_s: float) -> None:
        """Reopen the same sensor after its line was lost, on any port, and restore the subscriptions.

        Raises
        ------
        NoDeviceError
            It does not come back in time, or it cannot be distinguished from another one with its serial number.
        """
        deadline, doubt = time.monotonic() + timeout_s, ""
        self._writer.forget()
        self.close()
        self._whereabouts.look_around()
        while time.monotonic() < deadline:
            for port in dict.fromkeys([self._first_port, *candidate_ports()]):
                with contextlib.suppress(NoDeviceError):
                    doubt = self._resume_on(port)
                    if not doubt:
                        return
                self.close()
            self.on_turn(False)
            time.sleep(REOPEN_PAUSE_S)
        self.port = self._first_port
        away = f"the line was lost, and sensor {self.serial_number} is not back after {timeout_s:.0f} s"
        raise NoDeviceError(f"{self.port}: {away}{doubt}")

    def _resume_on(self, port: str) -> str:
        """Continue on `port` if the same sensor answers there, and return "".

        Otherwise return the reason why it may be another sensor with the same serial number; its messages are
        discarded. Raises NoDeviceError if this serial number does not answer on that port.
        """
        waiting, sink, heard = self.messages, self.raw_sink, list[bytes]()
        self.port, self.decoder, self.messages, self.raw_sink = port, Decoder(), Backlog(), heard.append
        self.damage.begin_decoder()
        try:
            self._serial = open_port(port, self._known)
            known = KnownPort(port)
            hello = self._say_hello(REOPEN_HELLO_S)
            if hello.device_serial != self.serial_number:
                raise NoDeviceError(f"{port}: another sensor")
            if why := self._whereabouts.doubt(port, self.hello, hello):
                return f": the one on {port} {why}: connect again by --port, and {REMEDY}"
        finally:
            arrived, self.messages, self.raw_sink = self.messages, waiting, sink
        if sink is not None:
            sink(b"".join(heard))
        while arrived:
            self.messages.append(*arrived.popleft())
        if hello.session_id != self.hello.session_id:
            self.clock = DeviceClock()
        self.hello, self._whereabouts, self._known = hello, Whereabouts(port), known
        if self._subscribed:
            self.subscribe(**self._subscribed)
        self.resumed_s = time.monotonic()
        return ""

    @property
    def serial_number(self) -> str:
        return str(self.hello.device_serial)

    # ---- receiving ----------------------------------------------------------------------------

    def _read(self) -> None:
        """Decode the bytes that have arrived into `messages`; waits at most 20 ms."""
        import serial

        try:
            data = self._serial.read(max(self._serial.in_waiting, 1))
        except (serial.SerialException, OSError, TypeError) as error:
            raise LineLostError(f"{self.port}: the line was lost: {error}") from error
        now_ns = time.monotonic_ns()
        sink = self.raw_sink  # another thread may take it away
        if sink is not None and data:
            sink(data)
        for frame in self.decoder.feed(data):
            message: Any = self.schema.decode(frame.type, frame.payload)
            if message is None:
                continue
            if frame.type == self.schema.type_numbers.get("TIME"):
                if (asked_ns := self._asked.pop(message.token, None)) is not None:
                    self.clock.add(asked_ns, message.received_us, message.sent_us, now_ns)
                continue
            stamp = getattr(message, "stamp", None)
            if stamp is not None and (host := self.clock.stamp(stamp.capture_us)) is not None:
                frame = replace(frame, host_time_ns=host.ns, host_time_error_ns=host.error_ns, read_ns=now_ns)
            self.messages.append(frame, message)
        if self.damage.update(self.decoder.counters.damaged, time.monotonic()):
            self.on_damage(f"{self.port}: {DAMAGED}")

    def _ask_time(self) -> None:
        """Start a time exchange if one is due."""
        due_s = FIRST_TIME_S if self.clock.n_exchanges < FIRST_TIMES else TIME_S
        if "TIME" not in self.schema.type_numbers or time.monotonic() - self._asked_s < due_s:
            return
        self._asked_s = time.monotonic()
        self._time_token += 1
        if len(self._asked) > MAX_ASKED:
            self._asked.clear()  # their answers were lost
        self._asked[self._time_token] = time.monotonic_ns()
        self._send("TIME", self.schema.new("Time", token=self._time_token).SerializeToString())

    def read_clock(self, timeout_s: float = REPLY_TIMEOUT_S) -> DeviceClock:
        """The sensor's clock after a few time exchanges; after none if the firmware does not support them."""
        deadline = time.monotonic() + timeout_s
        while self.clock.n_exchanges < FIRST_TIMES and time.monotonic() < deadline:
            self._ask_time()
            self._read()
        return self.clock

    def stream(
        self,
        *,
        timeout_s: float | None = None,
        resume_s: float = 0.0,
        on_gap: Callable[[LineGap], None] = lambda _: None,
    ) -> Iterator[tuple[Frame, Any]]:
        """Messages as they arrive; ends after `timeout_s` without one, never if None.

        A lost line is reopened for up to `resume_s`; `on_gap` is called before the next message with a stamp.

        Raises
        ------
        NoDeviceError
            The line was lost and did not come back within `resume_s`.
        """
        turn_s, silent_s = time.monotonic(), 0.0
        frame_before, lost = 0, None
        while True:
            while self.messages:
                last = time.monotonic()
                frame, message = self.messages.popleft()
                if (stamp := getattr(message, "stamp", None)) is not None:
                    if lost is not None:
                        is_same = lost[1] == self.hello.session_id
                        on_gap(LineGap(last - lost[0], max(stamp.frame - frame_before - 1, 0) if is_same else None))
                        lost = None
                    frame_before = stamp.frame
                yield frame, message
            try:
                self.on_turn(True)
                self._ask_time()
                self._read()
            except LineLostError:
                if not resume_s:
                    raise
                lost = lost or (time.monotonic(), self.hello.session_id)
                self.resume(resume_s)
                silent_s = 0.0
            # A longer iteration means that this process was suspended: bytes that arrived meanwhile are still unread.
            now_s = time.monotonic()
            silent_s = 0.0 if self.messages else silent_s + min(now_s - turn_s, MAX_TURN_S)
            turn_s = now_s
            if timeout_s is not None and silent_s > timeout_s:
                return

    def _wait_for(self, type_name: str, timeout_s: float, accept: Callable[[Any], bool]) -> Any | None:
        wanted = self.schema.type_numbers[type_name]
        deadline = time.monotonic() + timeout_s
        seen, is_late = 0, False
        while True:
            found = self.messages.take(lambda frame, message: frame.type == wanted and accept(message), seen)
            if found is not None or is_late:
                return found
            seen, is_late = self.messages.n_added, time.monotonic() >= deadline
            if not is_late or self._has_more():  # the reply may have arrived while this process was suspended
                self._read()

    def _has_more(self) -> bool:
        """True if unread bytes have arrived."""
        with contextlib.suppress(OSError):
            return bool(self._serial.in_waiting)
        return False

    # ---- sending ------------------------------------------------------------------------------

    def _write(self, data: bytes) -> None:
        import serial

        try:
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise NoDeviceError(f"{self.port}: the device does not read what is sent: is ruffinid running?") from error
        except (serial.SerialException, OSError) as error:
            raise LineLostError(f"{self.port}: the line was lost: {error}") from error

    def _send(self, type_name: str, payload: bytes = b"") -> None:
        number = self.schema.type_numbers[type_name]
        self._write(encode_message(number, payload, sensor=DEVICE, sequence=self._sequence))
        self._sequence += 1

    def _say_hello(self, timeout_s: float, tries: int = RETRIES, *, patience_s: float = 0.0) -> Any:
        """Ask `tries` times in `timeout_s`, and go on until `patience_s` as long as messages come between two tries."""
        self._write(b"\0")  # terminates a partial frame in the device's buffer
        # A slow device may still answer an earlier HELLO: discard those answers.
        number = self.schema.type_numbers["HELLO"]
        while self.messages.take(lambda frame, _: frame.type == number) is not None:
            pass
        start_s, n_asked, is_talking = time.monotonic(), 0, False
        while n_asked < tries or (is_talking and time.monotonic() - start_s < patience_s):
            n_before = self.messages.n_added
            self._send("HELLO")
            n_asked += 1
            hello = self._wait_for("HELLO", timeout_s / tries, lambda m: True)
            if hello is not None:
                if not hello.sensors:
                    raise NoDeviceError(f"{self.port}: the device names no sensor: update its firmware")
                return hello
            is_talking = self.messages.n_added > n_before
        raise NoDeviceError(f"{self.port}: nothing answers HELLO: is ruffinid running, and is it this port?")

    def _fetch_schema(self) -> Schema:
        for _ in range(TRIES):
            self._send("SCHEMA")
            message = self._wait_for("SCHEMA", REPLY_TIMEOUT_S, lambda m: True)
            if message is not None:
                return Schema(message.file_descriptor_set)
        raise NoDeviceError(f"{self.port}: the device does not serve its schema")

    def command(self, *, waits_s: Sequence[float] = (REPLY_TIMEOUT_S,) * int(TRIES * PATIENCE), **action: Any) -> Any:
        """Send one command, e.g. command(zero={"n_frames": 0}), and return its reply; retries reuse the request id.

        Parameters
        ----------
        waits_s : how long each try waits for the reply, seconds.

        Raises
        ------
        RefusedError
            The firmware does not know the command, or is busy with another one.
        NoDeviceError
            No reply came.
        """
        name = next(iter(action))
        self._writer.prepare(self, name)
        self._request_id = self._request_id % 0xFFFFFFF0 + 1
        request = self._request_id
        holder = {"holder": self._writer.holder} if self.schema.has_field("Command", "holder") else {}
        try:
            command = self.schema.new("Command", request_id=request, **holder, **action).SerializeToString()
        except ValueError as error:  # older firmware serves its own, smaller schema
            raise RefusedError(f"{self.port}: this firmware knows no {name}: update it") from error
        kind, payload = self._writer.wrap(self, name, command)
        for i, wait_s in enumerate(waits_s):
            if i > 0:
                self.n_retries += 1
                self._write(b"\0")  # terminates a frame whose end was lost, so that this one is not appended to it
            self._send(kind, payload)
            reply = self._wait_for("REPLY", wait_s, lambda m: m.request_id in (request, ASK_AGAIN))
            if reply is not None and reply.request_id == request:
                if reply.code == self.schema.enum_number("ReplyCode", "REPLY_BUSY"):
                    raise RefusedError(f"{self.port}: {reply.text}")
                return reply
        raise NoDeviceError(f"{self.port}: no reply to {name} after {len(waits_s)} tries")

    def checked(self, **action: Any) -> Any:
        """As `command`; raises RefusedError unless the reply is OK."""
        reply = self.command(**action)
        if reply.code:
            raise RefusedError(f"{self.port}: {reply.text}")
        return reply

    def refresh_hello(self) -> None:
        """Read the sensor's identity again; raises NoDeviceError if another sensor answers."""
        hello = self._say_hello(REPLY_TIMEOUT_S * TRIES, TRIES)
        if self.serial_number != hello.device_serial:
            raise NoDeviceError(
                f"{self.port}: sensor {hello.device_serial} answers in place of {self.serial_number}: connect again"
            )
        self.hello = hello

    def status(self) -> Any:
        """The current STATUS message; raises NoDeviceError if none comes."""
        for _ in range(TRIES):
            self._send("STATUS")
            if (status := self._wait_for("STATUS", REPLY_TIMEOUT_S, lambda _: True)) is not None:
                return status
        raise NoDeviceError(f"{self.port}: the sensor does not report its status: is it busy?")

    def subscribe(self, **every: int) -> None:
        """Subscribe to each n-th message of a type, e.g. subscribe(wrench=1, field=2); replaces earlier subscriptions.

        Of `YOUNG_TYPES` those are ignored that the firmware predates.
        """
        numbers = self.schema.type_numbers
        every = {name: n for name, n in every.items() if name.upper() in numbers or name not in YOUNG_TYPES}
        self.checked(
            subscribe={"subscriptions": [{"type": numbers[name.upper()], "every": n} for name, n in every.items()]}
        )
        self._subscribed = every

    def flash(
        self,
        data: bytes,
        progress: Callable[[float], None] = lambda _: None,
        say: Callable[[str], None] = lambda _: None,
    ) -> Any:
        """Upload a calibration file; returns once the device has confirmed it.

        An interrupted upload is continued. A new calibration is on trial until it has produced good frames; `say` is
        called with its progress.

        Raises
        ------
        RefusedError
            Wrong board, wrong key, a table that fails the device's checks, or a trial without good frames: the
            calibration before stays in force.
        NoDeviceError
            The line was lost and did not come back, or the camera delivers no frames for the trial.
        VerifyError
            The bytes received or stored differ from those sent, or the medium failed: what was before may be in force
            after a power cut.
        """
        return flashing.flash(self, data, progress, say)

    def read_calibration(self, progress: Callable[[float], None] = lambda _: None) -> bytes:
        """The calibration file in force, read back from the sensor and checked against its hash; empty if none.

        Raises
        ------
        RefusedError
            The firmware is too old for that.
        VerifyError
            The bytes received do not have the hash of the calibration in force.
        """
        return flashing.read_back(self, progress)

    def undo_flash(self) -> Any:
        """Restore the calibration that the last flash replaced; a second call restores the newer one.

        Raises
        ------
        RefusedError
            There was none before, or it no longer fits the board.
        VerifyError
            The storage failed, or the device did not change its calibration.
        """
        return flashing.undo(self)
