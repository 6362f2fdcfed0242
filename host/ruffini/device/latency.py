"""Latency from the end of a frame's exposure to the last byte of its results: percentiles, jitter, missing frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ruffini.errors import NoDeviceError

if TYPE_CHECKING:
    from ruffini.device.connection import Connection

N_WARM_UP = 30  # frames until the clock exchange has settled
TIMEOUT_S = 5.0  # without a message
MIN_FOR_P999 = 1000  # with fewer frames the 99.9th percentile is just the maximum


@dataclass(frozen=True)
class FrameAge:
    """Times of one frame on the host's clock, ns."""

    frame: int
    exposed_ns: int  # end of the exposure
    error_ns: int  # error bound of `exposed_ns`
    last_byte_ns: int  # arrival of the last of its messages


class Watched(NamedTuple):
    """The frames received during a run."""

    ages: list[FrameAge]
    is_simulated: bool
    is_replay: bool


@dataclass(frozen=True)
class Latency:
    """Latency statistics of a run; milliseconds from the end of the exposure to the last byte."""

    n_frames: int
    p50_ms: float
    p99_ms: float
    p999_ms: float | None  # None: fewer than 1000 frames
    largest_ms: float
    jitter_ms: float  # standard deviation
    n_missing: int  # frames between the first and the last that never arrived complete
    n_late: int  # frames that took longer than one frame interval
    interval_ms: float
    clock_error_ms: float  # common error bound of all latencies


def watch(sensor: Connection, n_frames: int, types: Sequence[str], after_ns: int) -> Watched:
    """Subscribe to `types` with every frame and record when the last message of each frame was read.

    Parameters
    ----------
    after_ns : int
        Time from the middle of the exposure, which the sensor stamps, to its end.

    Raises
    ------
    NoDeviceError
        No frame comes, or the firmware does not support time exchanges.
    """
    numbers = {sensor.schema.type_numbers[name.upper()] for name in types}
    stale = sensor.schema.enum_number("FlagBit", "FLAG_STALE")
    sensor.read_clock()
    sensor.subscribe(**dict.fromkeys(types, 1))
    whole: list[FrameAge] = []
    seen: dict[int, set[int]] = {}
    n_seen = 0
    for frame, message in sensor.stream(timeout_s=TIMEOUT_S):
        if frame.type not in numbers or message.stamp.flags & stale:
            continue
        types_of_frame = seen.setdefault(message.stamp.frame, set())
        n_seen += not types_of_frame
        types_of_frame.add(frame.type)
        if types_of_frame == numbers and frame.host_time_ns is not None and frame.read_ns is not None:
            error_ns = frame.host_time_error_ns or 0
            whole.append(FrameAge(message.stamp.frame, frame.host_time_ns + after_ns, error_ns, frame.read_ns))
        if n_seen > n_frames + N_WARM_UP:
            settled = [age for age in whole if age.frame >= min(seen) + N_WARM_UP]
            return Watched(settled, frame.is_simulated, frame.is_replay)
    raise NoDeviceError(f"{sensor.port}: {n_seen} frames, then none for {TIMEOUT_S:.0f} s: is the camera running?")


def summarize(ages: Iterable[FrameAge], interval_ms: float) -> Latency:
    """Statistics of a run.

    Raises
    ------
    NoDeviceError
        No frame arrived complete.
    """
    ages = list(ages)
    if not ages:
        raise NoDeviceError("no frame arrived complete: subscribe to less, or check the line with `ruffini doctor`")
    took_ms = np.array([(age.last_byte_ns - age.exposed_ns) / 1e6 for age in ages])
    p50, p99, p999 = np.percentile(took_ms, [50, 99, 99.9])
    span = ages[-1].frame - ages[0].frame + 1
    return Latency(
        n_frames=len(ages), p50_ms=float(p50), p99_ms=float(p99),
        p999_ms=float(p999) if len(ages) >= MIN_FOR_P999 else None, largest_ms=float(took_ms.max()),
        jitter_ms=float(took_ms.std()), n_missing=span - len(ages), n_late=int((took_ms > interval_ms).sum()),
        interval_ms=interval_ms, clock_error_ms=max(age.error_ns for age in ages) / 1e6,
    )  # fmt: skip
