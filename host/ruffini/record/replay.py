"""A recording as a sensor: a pty that answers as the recorded one did, at its own pace, every message marked REPLAY."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

from ruffini.record.recording import Recording
from ruffini.wire import Decoder, Frame, encode_message
from ruffini.wire.framing import REPLAY, SIMULATED

DEVICE = 255
NOT_PLAYED = ("HELLO", "SCHEMA", "REPLY", "TIME", "COMMAND", "SIGNED_COMMAND")
MAX_WAITING_BYTES = 1 << 20  # queued for a host that does not read; beyond it results are dropped, replies are not
REMEMBERED = 256  # frames whose playback time is kept, for late results
TURN_S = 0.02
QUIET_S = 1.0  # a pty that appears empty may still get bytes from the kernel
END_S = 20.0  # for a host that reads none of the last bytes


class ReplayedSensor:
    """Plays a recording on a new pty, whose other end is `port`.

    `Stamp.capture_us` is the playback time on this computer's monotonic clock; everything else is as recorded.
    Subscriptions, HELLO, SCHEMA, STATUS and TIME are answered, other commands are refused.

    Parameters
    ----------
    speed : playback speed, 2 is twice as fast.
    is_loop : restart at the end.
    """

    def __init__(self, recording: Recording, *, speed: float = 1.0, is_loop: bool = False) -> None:
        self._recording, self._schema, self._speed, self._is_loop = recording, recording.schema, speed, is_loop
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        os.close(slave)  # so that a hang-up of the host is detected
        os.set_blocking(self._master, False)
        self._hello = type(recording.hello).FromString(recording.hello.SerializeToString())
        self._hello.session_id = int.from_bytes(os.urandom(3), "little") + 1
        self._decoder = Decoder(from_host=True)
        self._every: dict[int, int] = {}
        self._counted: dict[tuple[int, int], int] = {}
        self._sequence: dict[int, int] = {}
        self._out = bytearray()
        self._flags, self._status = REPLAY, b""
        self._played_us: dict[tuple[int, int], int] = {}
        self.n_dropped = 0  # results that the host did not read in time
        self.n_frames = 0
        self._is_over = False

    def __enter__(self) -> ReplayedSensor:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._master)

    def run(self, should_stop: Callable[[], bool] = lambda: False) -> None:
        """Play from the first subscription to the end of the recording, or until `should_stop`."""
        while not self._every and not should_stop():
            self._turn(TURN_S)
        shift = 0  # of frame numbers, so that they continue after a restart
        while not should_stop():
            last = self._play(shift, should_stop)
            if not self._is_loop or last is None:
                break
            shift = last + 1
        # Bytes that the host has not read are lost when the pty is closed. Answers to it would keep it open.
        self._is_over = True
        read_s = pending_s = time.monotonic()
        n_before = self._n_unread()
        while self._every and not should_stop():
            self._turn(TURN_S)
            now_s, n = time.monotonic(), self._n_unread()
            pending_s = now_s if n else pending_s
            read_s = now_s if n != n_before else read_s
            n_before = n
            if now_s - pending_s > QUIET_S or now_s - read_s > END_S:
                break

    def _n_unread(self) -> int:
        """Bytes that the host has not read. The pty is opened for a moment only, so that a hang-up is noticed."""
        waiting = bytes(4)
        with contextlib.suppress(OSError):  # a host may have the pty to itself: then it reads within QUIET_S, or never
            end = os.open(self.port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            waiting = fcntl.ioctl(end, termios.FIONREAD, waiting)
            os.close(end)
        return len(self._out) + int.from_bytes(waiting, sys.byteorder)

    def _play(self, shift: int, should_stop: Callable[[], bool]) -> int | None:
        """Play once; returns the highest frame number."""
        began_s, first_us, last = time.monotonic(), None, None
        for packet, message in self._recording.packets():
            name = self._schema.type_name(packet.type)
            if name is None or name in NOT_PLAYED:
                continue
            stamp = getattr(message, "stamp", None)
            if stamp is not None and name != "LEARNED":
                first_us = stamp.capture_us if first_us is None else first_us
                due_s = began_s + (stamp.capture_us - first_us) * 1e-6 / self._speed
                while (wait_s := due_s - time.monotonic()) > 0 and not should_stop():
                    self._turn(min(wait_s, TURN_S))
            self._turn(0)
            if should_stop():
                break
            if stamp is not None:
                last = max(stamp.frame + shift, last or 0)
                self._set_stamp(packet.sensor, stamp, shift)
            self._tell(name, packet, message)
        return last

    def _set_stamp(self, sensor: int, stamp: Any, shift: int) -> None:
        key = (0 if sensor == DEVICE else sensor, stamp.frame + shift)
        if key not in self._played_us:
            self._played_us[key] = _now_us()
            self.n_frames += 1
            if len(self._played_us) > REMEMBERED:
                del self._played_us[next(iter(self._played_us))]
        stamp.capture_us, stamp.frame = self._played_us[key], stamp.frame + shift

    def _tell(self, name: str, packet: Frame, message: Any) -> None:
        self._flags = REPLAY | packet.flags & SIMULATED
        payload = message.SerializeToString()
        if name == "STATUS":
            self._status = payload
        every = 1 if name == "EVENT" else self._every.get(packet.type, 0)
        key = (packet.type, packet.sensor)
        n = self._counted[key] = self._counted.get(key, -1) + 1
        if not every or (name != "STATUS" and n % every):
            return
        if len(self._out) > MAX_WAITING_BYTES:
            self.n_dropped += 1
            return
        self._send(packet.type, payload, packet.sensor)

    def _send(self, kind: int, payload: bytes, sensor: int = DEVICE) -> None:
        n = self._sequence[sensor] = self._sequence.get(sensor, -1) + 1
        self._out += encode_message(kind, payload, sensor=sensor, sequence=n, flags=self._flags)

    # ---- the line -----------------------------------------------------------------------------

    def _turn(self, wait_s: float) -> None:
        """Read and answer the host's messages and write queued bytes, for at most `wait_s`."""
        readable, writable, _ = select.select([self._master], [self._master] if self._out else [], [], wait_s)
        try:
            if readable:
                for frame in self._decoder.feed(os.read(self._master, 65_536)):
                    self._answer(frame)
            if writable:
                del self._out[: os.write(self._master, self._out[:65_536])]
        except BlockingIOError:
            pass
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._hang_up()
            time.sleep(wait_s)

    def _hang_up(self) -> None:
        """The host has closed the line: drop the queue and the subscriptions."""
        self._out.clear()
        self._every = {}
        self._decoder = Decoder(from_host=True)

    def _answer(self, frame: Frame) -> None:
        name = None if self._is_over else self._schema.type_name(frame.type)
        if name == "HELLO":
            self._send(frame.type, self._hello.SerializeToString())
        elif name == "SCHEMA":
            said = self._schema.new("Schema", file_descriptor_set=self._schema.bytes, sha256=self._schema.sha256)
            self._send(frame.type, said.SerializeToString())
        elif name == "STATUS":
            self._send(frame.type, self._status)
        elif name == "TIME":
            asked: Any = self._schema.decode(frame.type, frame.payload)
            asked.received_us = asked.sent_us = _now_us()
            self._send(frame.type, asked.SerializeToString())
        elif name == "COMMAND":
            self._send(self._schema.type_numbers["REPLY"], self._reply(self._schema.decode(frame.type, frame.payload)))

    def _reply(self, command: Any) -> bytes:
        reply = self._schema.new("Reply", request_id=command.request_id)
        if command.WhichOneof("action") == "subscribe":
            self._every = {s.type: s.every for s in command.subscribe.subscriptions if s.every}
        else:
            reply.code = self._schema.enum_number("ReplyCode", "REPLY_REFUSED")
            reply.text = f"this is a recording ({self._recording.path.name}): commands are not possible"
        return bytes(reply.SerializeToString())


def _now_us() -> int:
    return time.monotonic_ns() // 1000


@contextlib.contextmanager
def replayed(recording: Recording, *, speed: float = 1.0, is_loop: bool = False) -> Iterator[str]:
    """Play in a separate thread; yields the port."""
    import threading

    stop = threading.Event()
    with ReplayedSensor(recording, speed=speed, is_loop=is_loop) as sensor:
        thread = threading.Thread(target=sensor.run, args=(stop.is_set,), daemon=True)
        thread.start()
        try:
            yield sensor.port
        finally:
            stop.set()
            thread.join()
