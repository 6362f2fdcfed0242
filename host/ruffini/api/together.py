"""Groups of frames of several sensors captured at the same time, by the host's clock."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass

from ruffini.api.frame import SensorFrame
from ruffini.api.in_asyncio import AsyncSensor
from ruffini.api.sensor import Sensor
from ruffini.errors import InputError

MAX_TIMELESS = 120  # consecutive frames without a capture time
TOLERANCE_S = 1 / 120  # half a period of the usual camera


@dataclass(frozen=True)
class FrameGroup:
    """One frame of each sensor, in the order of the sensors.

    Attributes
    ----------
    spread_s : time between the earliest and the latest middle of exposure.
    error_s : error bound of `spread_s`, from the bounds of the clocks.
    n_alone : frames without partners since the previous group.
    """

    frames: tuple[SensorFrame, ...]
    spread_s: float
    error_s: float
    n_alone: int

    def __iter__(self) -> Iterator[SensorFrame]:
        return iter(self.frames)


def synchronized(
    sources: Sequence[Sensor | Iterator[SensorFrame]], tolerance_s: float = TOLERANCE_S
) -> Iterator[FrameGroup]:
    """Groups of frames, one of each source, captured within `tolerance_s` of each other on the host's clock.

    With a tolerance of at most half the period of the fastest camera a frame has at most one partner. Frames without
    partners are skipped and counted; repeated results (`is_stale`) are never grouped.

    Parameters
    ----------
    sources : sensors, or iterators over their frames; all their frames are consumed.

    Raises
    ------
    InputError
        A sensor's firmware does not report capture times, or the tolerance is not above zero.
    NoDeviceError
        A sensor was lost.

    Examples
    --------
    >>> import ruffini
    >>> with ruffini.connect("/dev/ttyACM0") as left, ruffini.connect("/dev/ttyACM1") as right:  # doctest: +SKIP
    ...     for group in ruffini.synchronized([left, right]):
    ...         l, r = group
    """
    matcher = _Matcher(len(sources), tolerance_s)
    streams = [source.frames() if isinstance(source, Sensor) else iter(source) for source in sources]
    return _groups(matcher, streams)


def synchronized_async(
    sources: Sequence[AsyncSensor | AsyncIterator[SensorFrame]], tolerance_s: float = TOLERANCE_S
) -> AsyncIterator[FrameGroup]:
    """As `synchronized`, for `async for`."""
    matcher = _Matcher(len(sources), tolerance_s)
    streams = [source.frames() if isinstance(source, AsyncSensor) else aiter(source) for source in sources]
    return _groups_async(matcher, streams)


def _groups(matcher: _Matcher, streams: Sequence[Iterator[SensorFrame]]) -> Iterator[FrameGroup]:
    while True:
        try:
            for i in matcher.wanting():
                matcher.put(i, next(streams[i]))
        except StopIteration:  # a source has ended
            return
        if (group := matcher.group()) is not None:
            yield group


async def _groups_async(matcher: _Matcher, streams: Sequence[AsyncIterator[SensorFrame]]) -> AsyncIterator[FrameGroup]:
    while True:
        try:
            for i in matcher.wanting():
                matcher.put(i, await anext(streams[i]))
        except StopAsyncIteration:
            return
        if (group := matcher.group()) is not None:
            yield group


class _Matcher:
    """Holds the oldest frame of each source that may still find partners."""

    def __init__(self, n_sources: int, tolerance_s: float) -> None:
        if not tolerance_s > 0:
            raise InputError(f"tolerance_s = {tolerance_s}: give seconds above zero")
        if not n_sources:
            raise InputError("no sensors to synchronize: give at least one")
        self._tolerance_ns = tolerance_s * 1e9
        self._heads: list[SensorFrame | None] = [None] * n_sources
        self._n_timeless = [0] * n_sources
        self._n_alone = 0

    def wanting(self) -> list[int]:
        """Sources whose next frame is needed."""
        return [i for i, head in enumerate(self._heads) if head is None]

    def put(self, i: int, frame: SensorFrame) -> None:
        """Add the next frame; frames without a capture time are skipped, since a restarted sensor soon reports it."""
        if frame.is_stale:
            return
        if frame.host_time_ns is not None:
            self._heads[i], self._n_timeless[i] = frame, 0
            return
        self._n_timeless[i] += 1
        if self._n_timeless[i] > MAX_TIMELESS:
            raise InputError(f"sensor {frame.serial} does not report capture times: update its firmware")

    def group(self) -> FrameGroup | None:
        """The heads, if they belong together; otherwise the ones that are too old are dropped."""
        heads = [head for head in self._heads if head is not None]
        if not heads or len(heads) < len(self._heads):
            return None
        times = [head.host_time_ns or 0 for head in heads]
        latest, n_alone = max(times), self._n_alone
        late = [i for i, time_ns in enumerate(times) if latest - time_ns > self._tolerance_ns]
        for i in late or range(len(heads)):
            self._heads[i] = None
        self._n_alone = n_alone + len(late) if late else 0
        if late:
            return None
        errors = sorted(head.host_time_error_ns or 0 for head in heads)
        return FrameGroup(tuple(heads), (latest - min(times)) * 1e-9, sum(errors[-2:]) * 1e-9, n_alone)
