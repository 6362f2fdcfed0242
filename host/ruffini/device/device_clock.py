"""The sensor's clock on the host's, with a bound on how far off that is.

Two-way exchanges: the host notes when it asked (t1) and when the answer came (t4), the sensor when the question came
(t2) and when it answered (t3). Whatever the way there and the way back took, host minus sensor is
(t1 + t4 - t2 - t3) / 2 to within half of (t4 - t1) - (t3 - t2): the short exchanges say most. Between exchanges both
clocks drift apart.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

WINDOW_S = 120.0  # older exchanges go
MAX_EXCHANGES = 256
MAX_DRIFT = 300e-6  # of two crystals, seconds a second; assumed until more is known
WANDER = 2e-6  # by how much the drift may change within the window, with temperature
STEP_NS = 1_000  # the sensor counts microseconds: each of its two times may be as much off
MIN_SPAN_S = 1.0  # between two exchanges that say what the drift is


class HostTime(NamedTuple):
    """A time on the host's monotonic clock (`time.monotonic_ns`), right to within the error."""

    ns: int
    error_ns: int


class Exchange(NamedTuple):
    """One question and its answer: at this time of the sensor, host minus sensor was `offset_ns` +- `half_ns`."""

    device_ns: int
    offset_ns: float
    half_ns: float


class DeviceClock:
    """Offset and drift of one sensor's clock, from as many exchanges as there were.

    The bound holds while the drift stays within MAX_DRIFT and changes by no more than WANDER in WINDOW_S.
    """

    def __init__(self) -> None:
        self._exchanges: deque[Exchange] = deque(maxlen=MAX_EXCHANGES)
        self._anchor: Exchange | None = None
        self.drift, self.drift_error = 0.0, MAX_DRIFT  # host seconds more a second of the sensor
        self._last: tuple[int, HostTime] | None = None

    @property
    def n_exchanges(self) -> int:
        return len(self._exchanges)

    @property
    def latest_us(self) -> int:
        """The sensor's time of the last exchange."""
        return self._exchanges[-1].device_ns // 1_000

    def add(self, asked_ns: int, received_us: int, sent_us: int, answered_ns: int) -> None:
        """Take in an exchange; one that cannot be (answered before it was asked) is passed over."""
        device_ns = (received_us + sent_us) * 500
        half_ns = ((answered_ns - asked_ns) - (sent_us - received_us) * 1_000) / 2 + STEP_NS
        if sent_us < received_us or half_ns < STEP_NS / 2:
            return
        half_ns += MAX_DRIFT * (answered_ns - asked_ns)
        self._exchanges.append(Exchange(device_ns, (asked_ns + answered_ns) / 2 - device_ns, half_ns))
        while device_ns - self._exchanges[0].device_ns > WINDOW_S * 1e9:
            self._exchanges.popleft()
        self._fit_drift()
        self._anchor = min(self._exchanges, key=lambda e: self._bound_ns(e, device_ns))

    def _bound_ns(self, exchange: Exchange, device_ns: int) -> float:
        return exchange.half_ns + self.drift_error * abs(device_ns - exchange.device_ns)

    def _fit_drift(self) -> None:
        """From the shortest exchange of the window's first third to that of its last."""
        first_ns, last_ns = self._exchanges[0].device_ns, self._exchanges[-1].device_ns
        third_ns = (last_ns - first_ns) / 3
        self.drift, self.drift_error = 0.0, MAX_DRIFT
        if third_ns < MIN_SPAN_S * 1e9:
            return
        early = min((e for e in self._exchanges if e.device_ns - first_ns <= third_ns), key=lambda e: e.half_ns)
        late = min((e for e in self._exchanges if last_ns - e.device_ns <= third_ns), key=lambda e: e.half_ns)
        span_ns = late.device_ns - early.device_ns
        error = (early.half_ns + late.half_ns) / span_ns + WANDER
        if error < MAX_DRIFT:
            self.drift, self.drift_error = (late.offset_ns - early.offset_ns) / span_ns, error

    def to_host(self, device_us: int) -> HostTime | None:
        """When the host's clock showed what the sensor's showed as `device_us`; None before the first exchange."""
        if self._anchor is None:
            return None
        device_ns = device_us * 1_000
        offset_ns = self._anchor.offset_ns + self.drift * (device_ns - self._anchor.device_ns)
        return HostTime(device_ns + round(offset_ns), round(self._bound_ns(self._anchor, device_ns) + STEP_NS))

    def stamp(self, device_us: int) -> HostTime | None:
        """`to_host` of stamps as they come: later ones never get an earlier time, and the same one the same.

        What is better known since may set the clock back by part of the error: then time stands still for so long, and
        the stamps' errors say so.
        """
        found = self.to_host(device_us)
        if found is None or self._last is None:
            self._last = None if found is None else (device_us, found)
            return found
        last_us, last = self._last
        if device_us == last_us:
            return last
        if device_us < last_us:
            return found
        if found.ns <= last.ns:
            found = HostTime(last.ns + 1, found.error_ns + last.ns + 1 - found.ns)
        self._last = (device_us, found)
        return found
