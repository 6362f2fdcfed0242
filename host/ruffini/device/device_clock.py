"""Maps the sensor's clock to the host's, with an error bound.

Two-way time exchange: the host records when it sends the request (t1) and receives the answer (t4), the sensor when it
receives the request (t2) and sends the answer (t3). For any split of the transmission times, host minus sensor is
(t1 + t4 - t2 - t3) / 2 to within ((t4 - t1) - (t3 - t2)) / 2, so short exchanges are the most accurate. Between
exchanges the two clocks drift apart.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

WINDOW_S = 120.0  # older exchanges are dropped
MAX_EXCHANGES = 256
MAX_DRIFT = 300e-6  # between two crystals, s/s; assumed until the drift is measured
WANDER = 2e-6  # largest change of the drift within the window, with temperature, s/s
STEP_NS = 1_000  # resolution of the sensor's clock, the error of each of its two times
MIN_SPAN_S = 1.0  # shortest time between two exchanges from which the drift is measured


class HostTime(NamedTuple):
    """A time on the host's monotonic clock (`time.monotonic_ns`) and its error bound."""

    ns: int
    error_ns: int


class Exchange(NamedTuple):
    """One time exchange: at `device_ns` of the sensor, host minus sensor was `offset_ns` +- `half_ns`."""

    device_ns: int
    offset_ns: float
    half_ns: float


class DeviceClock:
    """Offset and drift of one sensor's clock, from the exchanges so far.

    The error bound holds while the drift stays within MAX_DRIFT and changes by at most WANDER in WINDOW_S.
    """

    def __init__(self) -> None:
        self._exchanges: deque[Exchange] = deque(maxlen=MAX_EXCHANGES)
        self._anchor: Exchange | None = None
        self.drift, self.drift_error = 0.0, MAX_DRIFT  # host seconds gained per second of the sensor
        self._last: tuple[int, HostTime] | None = None

    @property
    def n_exchanges(self) -> int:
        return len(self._exchanges)

    @property
    def latest_us(self) -> int:
        """Sensor time of the last exchange, microseconds."""
        return self._exchanges[-1].device_ns // 1_000

    def add(self, asked_ns: int, received_us: int, sent_us: int, answered_ns: int) -> None:
        """Add an exchange; impossible ones (answered before the request) are ignored."""
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
        """Drift between the shortest exchange in the first third of the window and that in the last."""
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
        """The host time of the sensor time `device_us`; None before the first exchange."""
        if self._anchor is None:
            return None
        device_ns = device_us * 1_000
        offset_ns = self._anchor.offset_ns + self.drift * (device_ns - self._anchor.device_ns)
        return HostTime(device_ns + round(offset_ns), round(self._bound_ns(self._anchor, device_ns) + STEP_NS))

    def stamp(self, device_us: int) -> HostTime | None:
        """As `to_host`, but monotonic: later stamps never get an earlier time, equal stamps get equal times.

        A better estimate may set the clock back by part of the error; host time then stands still, and the error
        bounds of the stamps grow accordingly.
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
