"""One picture's results, put together from the messages that come for it."""

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
SETTLED = 3  # frames that were seen to their end: from then on it is known what comes of each frame
LATEST = 64  # frames that a message may come behind; further back, the sensor counts anew


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """What a sensor says of one picture, SI units, pad frame (+z out of the pad, forces ON the pad).

    Parts are decoded when they are first asked for; None: it did not come (not subscribed, not of this board, or lost
    on the way). In each part `force`, `torque` and `depth` are NaN where they are not valid: see `flags` for why.

    Attributes
    ----------
    serial, sensor : which device, and which of its sensors; 255: a repeated result, the camera gives nothing.
    number : of the camera's frame.
    capture_s : middle of the exposure on the sensor's own clock.
    host_time_ns, host_time_error_ns : the same on `time.monotonic_ns()`, and how far off that may be. None: not known.
    flags : names of the FlagBits: reasons why something must not be used as it stands.
    n_missed : frames of the camera between the one before and this one that did not come to you. None: not known, the
        first one or a sensor that was started again.
    gap : the line was lost before this frame.
    is_whole : every message that is due has come. A repeated result is of WRENCH alone. What comes with each n-th frame
        is due n numbers after it came last: where the camera missed a frame, one frame more may count as partial.
    messages : the protobuf messages as they came, by type.
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
    learned: Learned | None = None  # the newest word of a learned network: `learned.frame` says of which frame
    gap: LineGap | None = None
    n_missed: int | None = None
    is_whole: bool = True

    @property
    def is_stale(self) -> bool:
        """The last result again, without a valid number: no new picture came."""
        return bool(self.flag_bits & FLAG_STALE)

    @property
    def is_valid(self) -> bool:
        """All that this board measures of the wrench is VALID."""
        wrench = self.wrench
        return wrench is not None and bool(measured := [v for v in wrench.validity if v]) and set(measured) == {VALID}

    def _part(self, name: str, kind: Any) -> Any:
        message = self.messages.get(name)
        return None if message is None else kind.from_message(message)

    @cached_property
    def wrench(self) -> Wrench | None:
        """Force and moment about the undeformed pad centre."""
        part: Wrench | None = self._part("WRENCH", Wrench)
        return part

    @cached_property
    def field(self) -> Field | None:
        """Force at every node, with displacement, slip and standard deviation where they are measured."""
        part: Field | None = self._part("FIELD", Field)
        return part

    @cached_property
    def depth(self) -> Depth | None:
        """The pad's surface."""
        part: Depth | None = self._part("DEPTH", Depth)
        return part

    @cached_property
    def residual(self) -> Residual | None:
        """What the forces do not explain, at every node; the sensor finds it only for who asks."""
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
        """The camera's picture; its pixels are a view of what came, not a copy."""
        part: Image | None = self._part("IMAGE", Image)
        return part


@dataclass
class _Open:
    """A frame that is not whole yet."""

    number: int
    packet: Frame
    messages: dict[str, Any]
    gap: LineGap | None = None  # before it


@dataclass
class _Stream:
    """One sensor's frames so far."""

    open: _Open | None = None
    last: int | None = None  # number of the frame that was given out
    n_seen: int = 0  # frames that were seen to their end
    held: list[_Open] = field(default_factory=list)  # the first ones, until it is known what makes them whole
    last_with: dict[str, int] = field(default_factory=dict)  # message type: last frame that had it
    missed: dict[str, int] = field(default_factory=dict)  # message type: last frame that should have had it
    every: dict[str, int] = field(default_factory=dict)  # message type: shortest way between two frames that had it
    late: deque[int] = field(default_factory=lambda: deque(maxlen=LATEST))  # frames that messages came late for
    learned: Any = None
    is_over: bool = False  # the sensor was started again

    def saw(self, name: str, number: int) -> None:
        """A message of that frame has come."""
        if (way := number - self.last_with.get(name, number)) > 0:
            self.every[name] = min(way, self.every.get(name, way))
        self.last_with[name] = number

    def awaited(self) -> list[str]:
        """Messages that the open frame may still get, by how often they came; one that was lost, until it comes."""
        assert self.open is not None
        number, absent = self.open.number, self.last_with.keys() - self.open.messages.keys()
        return [name for name in absent if number - self.last_with[name] >= self.every.get(name, math.inf)]

    def lost(self) -> list[str]:
        """Of the open frame, that is over: what it should have had. Each loss is one frame's."""
        assert self.open is not None
        number = self.open.number
        lost = [name for name in self.awaited() if number - self.missed.get(name, -math.inf) >= self.every[name]]
        self.missed.update(dict.fromkeys(lost, number))
        return lost


class Assembler:
    """Messages in the order of the line -> whole frames, as soon as all that is due has come.

    Parameters
    ----------
    schema : the device's own.
    serial : of the device.
    every : what was subscribed, by type, e.g. {"WRENCH": 1, "IMAGE": 10}. None, of a recording: a frame is whole when
        the next one begins.
    """

    def __init__(self, schema: Schema, serial: str, every: Mapping[str, int] | None) -> None:
        self._schema, self._serial = schema, serial
        self._streams: dict[int, _Stream] = {}
        self._flag_names: dict[int, tuple[str, ...]] = {}
        self._gap: LineGap | None = None
        # Messages that are not of every frame must have come twice.
        self._n_settled = math.inf if every is None else max([SETTLED, *(2 * n + 1 for n in every.values())])
        self.n_late = 0  # frames of which a message came after they had been given out

    def note_gap(self, gap: LineGap) -> None:
        """The line was lost; the next frame says so."""
        self._gap = gap
        for stream in self._streams.values():
            stream.is_over |= gap.n_frames is None

    def put(self, packet: Frame, message: Any) -> Iterator[SensorFrame]:
        """Take in a message; yields the frames that it makes whole."""
        name = self._schema.type_name(packet.type)
        stamp = getattr(message, "stamp", None)
        if stamp is None or name is None:
            return
        if packet.sensor == DEVICE:
            for stream in self._streams.values():  # what it repeats goes first: nothing older is still to come
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
            stream.saw(name, number)  # frames to come wait for its like
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
        stream.saw(name, number)
        if stream.n_seen >= self._n_settled and not stream.awaited():
            yield self._finish(stream)

    def flush(self) -> Iterator[SensorFrame]:
        """What is still open, when no more comes."""
        for stream in self._streams.values():
            yield from self._release(stream)

    def _release(self, stream: _Stream) -> Iterator[SensorFrame]:
        """What was held, and what is open."""
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
