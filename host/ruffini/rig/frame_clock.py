"""Simulated time: as fast as a twin's frames can be made and read, and no faster.

Each frame that is made takes one period of the camera; the next is made when the host has read the one before. So a
bench sees the same on a fast computer, on a slow one, and on one that is busy. Where no frame is made, since no camera
wants one or the camera stands still, time goes on at its real pace.
"""

from __future__ import annotations

import threading
import time

PATIENCE_S = 0.1  # real: a host that does not read, since it has not subscribed yet, is waited for so long
GRACE_S = 0.3  # real: longer without a frame, and time goes on without


class FrameClock:
    """A `host_clock.Clock` that a `TwinServer` drives."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._changed = threading.Condition()
        self._frame, self._seen = 0, 0
        self._made_s = time.monotonic()

    def now(self) -> float:
        with self._changed:
            return self._now()

    def _now(self) -> float:
        return self._frame * self._period_s + max(0.0, time.monotonic() - self._made_s - GRACE_S)

    def sleep(self, duration_s: float) -> None:
        with self._changed:
            end_s = self._now() + duration_s
            while self._now() < end_s:
                self._changed.wait(GRACE_S / 10)

    def has_seen(self, frame: int) -> None:
        with self._changed:
            self._seen = max(self._seen, frame)
            self._changed.notify_all()

    def next_frame(self) -> int:
        """Waits until the host has read the frame before; time is that of the frame with this number from now on."""
        with self._changed:
            self._changed.wait_for(lambda: self._seen >= self._frame, PATIENCE_S)
            self._frame = int(self._now() / self._period_s + 1e-6) + 1
            self._made_s = time.monotonic()
            self._changed.notify_all()
            return self._frame
