"""The clock that a bench lives by: the host's own, or one that a simulated bench lends.

Whatever happens on a bench (a tip that moves, a press that is held, a reading, a frame) is timed by `now` and `sleep`.
How long to wait for a device's answer is not: that is real time, always.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Protocol


class Clock(Protocol):
    """Time on a bench. Any thread."""

    def now(self) -> float:
        """Seconds, from anywhere; never goes back."""

    def sleep(self, duration_s: float) -> None:
        """Wait."""

    def has_seen(self, frame: int) -> None:
        """The host has read this frame of the sensor's stream."""

    def has_spoken(self) -> None:
        """A simulated reference has spoken just now."""

    def has_heard(self, reading_s: float) -> None:
        """The host has read what a reference said, until this time."""


class RealTime:
    """The host's own clock: `time.monotonic`."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def has_seen(self, frame: int) -> None:
        """Real time waits for nobody."""

    def has_spoken(self) -> None:
        """Nor here."""

    def has_heard(self, reading_s: float) -> None:
        """Nor here."""


_lent: list[Clock] = [RealTime()]  # the last one counts


@contextlib.contextmanager
def lent(clock: Clock) -> Iterator[None]:
    """Inside, every thread of this process lives by `clock`."""
    _lent.append(clock)
    try:
        yield
    finally:
        _lent.remove(clock)


def now() -> float:
    """Seconds of the clock that counts; for differences only."""
    return _lent[-1].now()


def sleep(duration_s: float) -> None:
    """Wait by the clock that counts."""
    _lent[-1].sleep(duration_s)


def has_seen(frame: int) -> None:
    """Tell the clock that counts how far the host has read the stream."""
    _lent[-1].has_seen(frame)


def has_spoken() -> None:
    """Tell the clock that counts that a simulated reference spoke."""
    _lent[-1].has_spoken()


def has_heard(reading_s: float) -> None:
    """Tell the clock that counts how far the host has read the reference."""
    _lent[-1].has_heard(reading_s)
