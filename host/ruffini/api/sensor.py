"""A sensor as a program uses it: a stream of frames and a few commands; a thread of its own reads the line."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, TypeVar

import numpy as np

from ruffini.api.frame import Assembler, SensorFrame
from ruffini.api.frames import Frames
from ruffini.device import choice
from ruffini.device.connection import SILENCE_S, Connection
from ruffini.device.health import health_words
from ruffini.device.line_gap import LineGap
from ruffini.device.namesakes import same_serial, usb_namesakes
from ruffini.device.results import Array
from ruffini.errors import InputError, NoDeviceError, RuffiniError
from ruffini.wire import Frame

BACKLOG = 512  # frames queued for a busy program
RESUME_S = 10.0
CLOSE_S = 5.0
T = TypeVar("T")


class Sensor:
    """An open sensor, created by `ruffini.connect`; use as a context manager. Thread-safe.

    Attributes
    ----------
    serial_number, boards : serial number of the device and names of its sensors' boards.
    health : the device's present problems in words; empty if there are none or no frames were requested yet.
    n_left_out : messages dropped because too many arrived while a command waited for its reply.
    n_late : frames of which a message arrived after the frame had been passed on.
    """

    def __init__(
        self, connection: Connection, every: dict[str, int], *, resume_s: float = RESUME_S,
        on_note: Callable[[str], None] = lambda _: None,
    ) -> None:  # fmt: skip
        self._connection, self._resume_s, self._on_note = connection, resume_s, on_note
        self.port, self.serial_number = connection.port, connection.serial_number
        self.boards = tuple(s.board for s in connection.hello.sensors)
        self.health: tuple[str, ...] = ()
        self._assembler = Assembler(connection.schema, self.serial_number, {k.upper(): n for k, n in every.items()})
        self._frames: weakref.WeakSet[Frames] = weakref.WeakSet()
        self._lock = threading.Lock()  # of `_frames`
        self._asked: deque[tuple[Callable[[Connection], Any], Future[Any]]] = deque()
        self._is_closing = False
        self._end: BaseException | None = None
        self._frame_s, self._n_told = time.monotonic(), 0
        if others := usb_namesakes(self.port, self.serial_number):
            on_note(same_serial(self.serial_number, [self.port, *others]))
        connection.on_damage = on_note
        connection.on_turn = self._turn
        connection.read_clock()
        self._every, self._is_subscribed = every, False
        self._thread = threading.Thread(target=self._read, name=f"ruffini {self.port}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Sensor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def n_left_out(self) -> int:
        return self._connection.messages.n_dropped

    @property
    def n_late(self) -> int:
        return self._assembler.n_late

    def close(self) -> None:
        """Close the port; iterators return the frames still queued, then end."""
        self._is_closing = True
        self._thread.join(CLOSE_S)

    def frames(self, *, newest: bool = False, sensor: int | None = None, partial: bool = False) -> Frames:
        """Endless iterator over the frames from now on. The sensor starts to send with the first call.

        Parameters
        ----------
        newest : keep only the newest frame while the program is busy, for control loops. Otherwise every frame is
            queued, at most BACKLOG of them.
        sensor : only frames of this sensor, on a device with several.
        partial : also frames that lost a part on the line; that part is None. A line that is too slow for all
            subscribed messages loses parts: subscribe to fewer, e.g. connect(depth=0).

        Raises
        ------
        NoDeviceError
            While iterating: the line was lost and did not come back, or no frame came within SILENCE_S.
        """
        frames = Frames(1 if newest else BACKLOG, sensor, partial=partial)
        with self._lock:
            self._frames.add(frames)
        if self._end is not None:
            frames.end(self._end)
        elif not self._is_subscribed:
            self.call(self._subscribe)
        return frames

    def read(self, timeout_s: float = SILENCE_S) -> SensorFrame:
        """The next frame.

        Raises
        ------
        NoDeviceError
            No frame came in time, or the sensor is closed.
        """
        try:
            frame = self.frames(newest=True).get(timeout_s)
        except StopIteration:
            frame = None
        if frame is None:
            raise NoDeviceError(f"{self.port}: no frame for {timeout_s:.1f} s: is the camera running?")
        return frame

    def nodes(self, sensor: int = 0) -> Array:
        """Positions of the field's nodes on the undeformed pad, (n_y, n_x, 2) metres from its centre."""
        return node_places(self._info(sensor))

    def zero(self, *, even_if_touched: bool = False) -> None:
        """Learn a new rest image from the next frames, which carry FLAG_NO_REFERENCE.

        A contact during that time aborts it: the previous rest image stays, with a note `zero_refused`. While a flag
        such as FLAG_LIGHT makes forces invalid no contact is seen: it becomes part of the rest image.

        Raises
        ------
        RefusedError
            The pad is in contact, or another program holds the sensor's lease.
        """
        self.call(lambda c: c.checked(zero={"n_frames": 0, "even_if_touched": even_if_touched}))

    def call(self, action: Callable[[Connection], T]) -> T:
        """Run `action` on the connection in the reading thread, e.g. `sensor.call(Connection.status)`.

        Must not be called from `on_note`, which runs in that thread.

        Raises
        ------
        NoDeviceError
            The sensor is lost or closed. Exceptions of `action` are passed on.
        """
        future: Future[T] = Future()
        self._asked.append((action, future))
        if self._end is not None:  # the reading thread has ended
            self._refuse_asked()
        return future.result()

    def _subscribe(self, connection: Connection) -> None:
        if not self._is_subscribed:
            connection.subscribe(**self._every, status=1)
            self._is_subscribed, self._frame_s = True, time.monotonic()

    def _info(self, sensor: int) -> Any:
        return sensor_info(self._connection.hello, sensor, self.port)

    # ---- the thread ---------------------------------------------------------------------------

    def _turn(self, is_open: bool) -> None:
        while self._asked and is_open:
            action, future = self._asked.popleft()
            try:
                future.set_result(action(self._connection))
            except Exception as error:
                future.set_exception(error)
        if self._is_closing:
            raise _Closed
        silent_s = time.monotonic() - max(self._frame_s, self._connection.resumed_s)
        if self._is_subscribed and is_open and silent_s > SILENCE_S:
            raise NoDeviceError(f"{self.port}: no frame for {SILENCE_S:.0f} s: is the camera running?")

    def _read(self) -> None:
        end: BaseException = StopIteration()
        try:
            for packet, message in self._connection.stream(resume_s=self._resume_s, on_gap=self._gap):
                self._take(packet, message)
        except _Closed:
            pass
        except BaseException as error:  # a bug of ours: passed on to the iterators
            end = error
        finally:
            self._connection.close()
            self._give(self._assembler.flush())
            self._end = end
            for frames in self._waiting():
                frames.end(end)
            self._refuse_asked()

    def _waiting(self) -> list[Frames]:
        with self._lock:
            return list(self._frames)

    def _refuse_asked(self) -> None:
        gone = NoDeviceError(f"{self.port} is closed: connect again")
        with contextlib.suppress(IndexError):  # empty; the reading thread and later callers may both empty it
            while True:
                _, future = self._asked.popleft()
                future.set_exception(self._end if isinstance(self._end, RuffiniError) else gone)

    def _gap(self, gap: LineGap) -> None:
        self._assembler.note_gap(gap)
        self._on_note(f"{self.port}: {gap}")

    def _take(self, packet: Frame, message: Any) -> None:
        if (n := self.n_left_out) != self._n_told:
            why = "too many arrived while a command waited for its reply"
            self._on_note(f"{self.port}: {n - self._n_told} messages were dropped: {why}")
            self._n_told = n
        name = self._connection.schema.type_name(packet.type)
        if name == "EVENT":
            self._on_note(f"{self.port}: {message.what}: {message.text}")
        if name == "STATUS":
            self._hear_health(message)
        self._give(self._assembler.put(packet, message))

    def _give(self, made: Iterator[SensorFrame]) -> None:
        for frame in made:
            self._frame_s = time.monotonic()
            for frames in self._waiting():
                frames.put(frame)

    def _hear_health(self, status: Any) -> None:
        words = tuple(health_words(self._connection.schema.enum_names("HealthBit", status.health)))
        if words != self.health:
            self.health = words
            self._on_note(f"{self.port}: health: {'; '.join(words) or 'nothing is wrong'}")


class _Closed(Exception):
    """`close` was called."""


def sensor_info(hello: Any, sensor: int, where: str) -> Any:
    """The SensorInfo of one sensor in HELLO; raises InputError if the device has no such sensor."""
    for info in hello.sensors:
        if info.sensor == sensor:
            return info
    raise InputError(f"{where}: has no sensor {sensor}: it has {', '.join(str(s.sensor) for s in hello.sensors)}")


def node_places(info: Any) -> Array:
    """Positions of the nodes of a SensorInfo, (n_y, n_x, 2) metres from the pad's centre."""
    x = (info.grid_origin_x_nm + info.grid_step_x_nm * np.arange(info.grid_n_x)) * 1e-9
    y = (info.grid_origin_y_nm + info.grid_step_y_nm * np.arange(info.grid_n_y)) * 1e-9
    return np.stack(np.meshgrid(x, y), axis=-1)


def connect(
    port: str | None = None, serial: str | None = None, *, wrench: int = 1, field: int = 1, contacts: int = 1,
    depth: int = 1, learned: int = 1, image: int = 0, markers: int = 0, residual: int = 0,
    resume_s: float = RESUME_S, on_note: Callable[[str], None] = lambda _: None,
) -> Sensor:  # fmt: skip
    """Open the sensor on `port`, the one with this serial number, or the only one that is connected.

    Parameters
    ----------
    port, serial : default to the environment variables RUFFINI_PORT and RUFFINI_SERIAL.
    wrench, field, contacts, depth, learned, image, markers, residual : send this message with each n-th frame, 0 never.
    resume_s : how long to wait for a lost line; 0 raises at once.
    on_note : called from the reading thread with messages for the user: health, events, a lost or damaged line.

    Raises
    ------
    NoDeviceError, SeveralDevicesError
        No sensor answers, or several do.

    Examples
    --------
    >>> import ruffini
    >>> with ruffini.connect() as sensor:  # doctest: +SKIP
    ...     for frame in sensor.frames():
    ...         print(frame.wrench.force, frame.flags)
    """
    every = {"wrench": wrench, "field": field, "contacts": contacts, "depth": depth, "learned": learned,
             "image": image, "markers": markers, "residual": residual}  # fmt: skip
    connection = choice.connect(port, serial)
    try:
        return Sensor(connection, every, resume_s=resume_s, on_note=on_note)
    except BaseException:
        connection.close()
        raise
