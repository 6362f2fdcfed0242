"""Frames of several sensors that were taken at the same time, by the host's clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ruffini.api.frame import SensorFrame
from ruffini.api.sensor import Sensor
from ruffini.errors import InputError

MAX_TIMELESS = 120  # frames in a row
TOLERANCE_S = 1 / 120  # half a period of the usual camera


@dataclass(frozen=True)
class FrameGroup:
    """One frame of each sensor, in their order.

    Attributes
    ----------
    spread_s : between the earliest and the latest middle of exposure.
    error_s : by how much that may be off, from the bounds of both clocks.
    n_alone : frames since the group before that found no partners.
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
    """Groups of frames, one of each source, within `tolerance_s` of each other on the host's clock.

    Give at most half a period of the fastest camera: then a frame has one partner at most. Frames without partners
    are passed over and counted; repeated results (`is_stale`) have none.

    Parameters
    ----------
    sources : sensors, or iterators over their frames; every frame of them is looked at.

    Raises
    ------
    InputError
        A sensor is too old to say when its frames were taken, or the tolerance is not above zero.
    NoDeviceError
        A sensor is gone.

    Examples
    --------
    >>> import ruffini
    >>> with ruffini.connect("/dev/ttyACM0") as left, ruffini.connect("/dev/ttyACM1") as right:  # doctest: +SKIP
    ...     for group in ruffini.synchronized([left, right]):
    ...         l, r = group
    """
    if not tolerance_s > 0:
        raise InputError(f"tolerance_s = {tolerance_s}: give seconds above zero")
    streams = [source.frames() if isinstance(source, Sensor) else iter(source) for source in sources]
    return _groups(streams, tolerance_s)


def _groups(streams: Sequence[Iterator[SensorFrame]], tolerance_s: float) -> Iterator[FrameGroup]:
    n_alone = 0
    try:
        heads = [_next(stream) for stream in streams]
        while True:
            times = [frame.host_time_ns or 0 for frame in heads]
            latest = max(times)
            late = [i for i, time_ns in enumerate(times) if latest - time_ns > tolerance_s * 1e9]
            if late:
                n_alone += len(late)
                for i in late:
                    heads[i] = _next(streams[i])
                continue
            errors = sorted(frame.host_time_error_ns or 0 for frame in heads)
            yield FrameGroup(tuple(heads), (latest - min(times)) * 1e-9, sum(errors[-2:]) * 1e-9, n_alone)
            n_alone = 0
            heads = [_next(stream) for stream in streams]
    except StopIteration:  # a source has ended
        return


def _next(stream: Iterator[SensorFrame]) -> SensorFrame:
    """The next new frame whose time is known; a sensor that was started again has to say the time anew."""
    for _ in range(MAX_TIMELESS):
        while (frame := next(stream)).is_stale:
            pass
        if frame.host_time_ns is not None:
            return frame
    raise InputError(f"sensor {frame.serial}: does not say when its frames were taken: update its firmware")
