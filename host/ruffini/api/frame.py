"""The results of one camera frame, assembled from its messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ruffini.device.line_gap import LineGap
from ruffini.device.results import VALID, Contacts, Depth, Field, Image, Learned, Markers, Residual, Wrench
from ruffini.wire import Frame, Schema

FLAG_STALE = 256
DEVICE = 255
SETTLED = 3  # complete frames after which the set of messages per frame is known
LATEST = 64  # a message may be this many frames late; further back, the sensor has restarted its count


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """All results of one camera frame, in SI units and the pad frame (+z out of the pad, forces act ON the pad).

    Parts are decoded on first access. A part is None if it did not arrive: not subscribed, not produced by this board,
    or lost on the line. In each part `force`, `torque` and `depth` are NaN where not valid; `flags` give the reason.

    Attributes
    ----------
    serial, sensor : serial number of the device, and index of the sensor on it; 255 marks a repeated result, sent
        while the camera delivers no frame.
    number : number of the camera's frame.
    capture_s : middle of the exposure on the sensor's own clock.
    host_time_ns, host_time_error_ns : the same on `time.monotonic_ns()`, and its error bound; None if unknown.
    flags : names of the set FlagBits, the reasons why a result must not be used as it is.
    n_missed : camera frames lost, or left out (HEALTH_RATE), between the previous frame and this one; None for the
        first frame and after a restart of the sensor.
    gap : the interruption of the line before this frame, if any.
    is_whole : True if every message that is due has arrived. A repeated result consists of WRENCH alone. A message
        sent with each n-th frame is due n frames after its last one; if the camera drops a frame, one frame may
        therefore be reported as partial.
    messages : the protobuf messages as received, by type.
    """

    serial: str
    sensor: int
    number: int
    capture_s: float
    host_time_ns: int | None
    host_time_error_ns: int | None
    flag_bits: int
    flags: tuple[str, ...]
    is_simulated: bool
    is_replay: bool
    messages: Mapping[str, Any] = field(repr=False)
    learned: Learned | None = None  # the newest output of a learned network, which belongs to frame `learned.frame`
    gap: LineGap | None = None
    n_missed: int | None = None
    is_whole: bool = True

    @property
    def is_stale(self) -> bool:
        """True for a repeated result without valid numbers, sent because no new camera frame came."""
        return bool(self.flag_bits & FLAG_STALE)

    @property
    def is_valid(self) -> bool:
        """True if every component of the wrench that this board measures is VALID; flags may still forbid its use."""
        wrench = self.wrench
        return wrench is not None and bool(measured := [v for v in wrench.validity if v]) and set(measured) == {VALID}

    def _part(self, name: str, kind: Any) -> Any:
        message = self.messages.get(name)
        return None if message is None else kind.from_message(message)

    @cached_property
    def wrench(self) -> Wrench | None:
        """Force and moment about the centre of the undeformed pad."""
        part: Wrench | None = self._part("WRENCH", Wrench)
        return part

    @cached_property
    def field(self) -> Field | None:
        """Force at every node, with displacement, slip and standard deviation where measured."""
        part: Field | None = self._part("FIELD", Field)
        return part

    @cached_property
    def depth(self) -> Depth | None:
        """The pad's surface."""
        part: Depth | None = self._part("DEPTH", Depth)
        return part

    @cached_property
    def residual(self) -> Residual | None:
        """Displacement that the forces do not explain, at every node; computed only while subscribed."""
        part: Residual | None = self._part("RESIDUAL", Residual)
        return part

    @cached_property
    def contacts(self) -> Contacts | None:
        """The separate contacts, largest first, in `contacts.contacts`."""
        part: Contacts | None = self._part("CONTACTS", Contacts)
        return part

    @cached_property
    def markers(self) -> Markers | None:
        """Markers, patches or targets in the image."""
        part: Markers | None = self._part("MARKERS", Markers)
        return part

    @cached_property
    def image(self) -> Image | None:
        """The camera's picture; its pixels are a view of the received bytes, not a copy."""
        part: Image | None = self._part("IMAGE", Image)
        return part


@dataclass
class _Open:
    """A frame that still waits for messages."""

    number: int
    packet: Frame
    messages: dict[str, Any]
    gap: LineGap | None = None  # before it


@dataclass
class _Stream:
    """State of the assembly of one sensor's frames."""

    open: _Open | None = None
    last: int | None = None  # number of the last frame passed on
    n_seen: int = 0  # complete frames
    held: list[_Open] = field(default_factory=list)  # the first frames, until the set of messages is known
    last_with: dict[str, int] = field(default_factory=dict)  # by message type: last frame that had it
    missed: dict[str, int] = field(default_factory=dict)  # by message type: last frame that should have had it
    every: dict[str, int] = field(default_factory=dict)  # by message type: shortest interval between frames with it
    late: deque[int] = field(default_factory=lambda: deque(maxlen=LATEST))  # frames with late messages
    learned: Any = None
    is_over: bool = False  # the sensor has restarted

    def note_arrival(self, name: str, number: int) -> None:
        """Record the arrival of a message of that frame."""
        if (way := number - self.last_with.get(name, number)) > 0:
            self.every[name] = min(way, self.every.get(name, way))
        self.last_with[name] = number

    def awaited(self) -> list[str]:
        """Types that the open frame still expects, judged by their usual interval."""
        assert self.open is not None
        number, absent = self.open.number, self.last_with.keys() - self.open.messages.keys()
        return [name for name in absent if number - self.last_with[name] >= self.every.get(name, math.inf)]

    def lost(self) -> list[str]:
        """Types that the open frame should have had but never got; each loss counts for one frame only."""
        assert self.open is not None
        number = self.open.number
        lost = [name for name in self.awaited() if number - self.missed.get(name, -math.inf) >= self.every[name]]
        self.missed.update(dict.fromkeys(lost, number))
        return lost


class Assembler:
    """Assembles messages, in the order of the line, into frames; each is passed on once all due messages are there.

    Parameters
    ----------
    schema : the device's own schema.
    serial : the device's serial number.
    every : subscriptions by type, e.g. {"WRENCH": 1, "IMAGE": 10}; None for a recording, where a frame is complete
        when the next one begins.
    """

    def __init__(self, schema: Schema, serial: str, every: Mapping[str, int] | None) -> None:
        self._schema, self._serial = schema, serial
        self._streams: dict[int, _Stream] = {}
        self._flag_names: dict[int, tuple[str, ...]] = {}
        self._gap: LineGap | None = None
        # Messages that are not sent with every frame must have arrived twice before their interval is known.
        self._n_settled = math.inf if every is None else max([SETTLED, *(2 * n + 1 for n in every.values())])
        self.n_late = 0  # frames of which a message arrived after the frame had been passed on

    def note_gap(self, gap: LineGap) -> None:
        """Attach an interruption of the line to the next frame."""
        self._gap = gap
        for stream in self._streams.values():
            stream.is_over |= gap.n_frames is None

    def put(self, packet: Frame, message: Any) -> Iterator[SensorFrame]:
        """Add a message; yields the frames that it completes."""
        name = self._schema.type_name(packet.type)
        stamp = getattr(message, "stamp", None)
        if stamp is None or name is None:
            return
        if packet.sensor == DEVICE:
            for stream in self._streams.values():  # the repeated frame goes first: nothing older can still arrive
                yield from self._release(stream)
            yield self._made(_Open(stamp.frame, packet, {name: message}), None, False)
            return
        stream = self._streams.setdefault(packet.sensor, _Stream())
        if name == "LEARNED":
            stream.learned = Learned.from_message(message)
            return
        number = stamp.frame
        newest = stream.open.number - 1 if stream.open is not None else stream.last
        if stream.is_over or (newest is not None and newest - number >= LATEST):
            yield from self._release(stream)
            stream = self._streams[packet.sensor] = _Stream()
        elif newest is not None and newest >= number:
            stream.note_arrival(name, number)  # later frames wait for messages of this type
            self.n_late += number not in stream.late
            stream.late.append(number)
            return
        if stream.open is not None and number != stream.open.number:
            stream.n_seen += 1
            if stream.n_seen <= SETTLED:
                stream.held.append(stream.open)
                stream.last, stream.open = stream.open.number, None
                if stream.n_seen == SETTLED:
                    yield from self._release(stream)
            else:
                yield self._finish(stream)
        if stream.open is None:
            stream.open, self._gap = _Open(number, packet, {}, self._gap), None
        stream.open.messages[name] = message
        stream.note_arrival(name, number)
        if stream.n_seen >= self._n_settled and not stream.awaited():
            yield self._finish(stream)

    def flush(self) -> Iterator[SensorFrame]:
        """Yield the open frames at the end of the stream."""
        for stream in self._streams.values():
            yield from self._release(stream)

    def _release(self, stream: _Stream) -> Iterator[SensorFrame]:
        """Yield the held frames and the open one."""
        for whole in stream.held:
            always = {name for name in stream.last_with if stream.every.get(name) == 1}
            yield self._made(whole, None, always <= set(whole.messages))
        stream.held = []
        if stream.open is not None:
            yield self._finish(stream)

    def _finish(self, stream: _Stream) -> SensorFrame:
        assert stream.open is not None
        lost = stream.lost()
        whole, stream.open = stream.open, None
        stream.last = whole.number
        return self._made(whole, stream.learned, not lost)

    def _made(self, whole: _Open, learned: Learned | None, is_whole: bool) -> SensorFrame:
        bits = 0
        for message in whole.messages.values():
            bits |= message.stamp.flags
        names = self._flag_names.get(bits)
        if names is None:
            names = self._flag_names[bits] = tuple(self._schema.enum_names("FlagBit", bits))
        packet = whole.packet
        stamp = next(iter(whole.messages.values())).stamp
        return SensorFrame(
            self._serial, packet.sensor, whole.number, stamp.capture_us * 1e-6, packet.host_time_ns,
            packet.host_time_error_ns, bits, names, packet.is_simulated, packet.is_replay, whole.messages, learned,
            whole.gap, None, is_whole,
        )  # fmt: skip
