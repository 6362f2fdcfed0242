"""Simulated time, driven by the twin's frames.

Each frame advances time by one camera period; the next frame is made once the host has read the last one and the
reference's readings for it. While a frame is being drawn time stands still. A bench therefore behaves the same on
fast, slow and busy computers. While no frame comes, because no camera is open or it has stalled, time runs at its real
pace.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from ruffini.patience import PATIENCE
from ruffini.wake_event import WakeEvent

POLL_S = 0.05  # real, of those who sleep where no frame comes
FIRST_S = 0.05  # real: so long a host is waited for that has not subscribed yet
PATIENCE_S = 2.0  # real: and so long one that reads
# Real: longer without a frame, and time goes on without. A busy computer takes seconds for one.
GRACE_S = 5.0 * PATIENCE


class FrameClock:
    """A `host_clock.Clock` driven by a `TwinServer`, which makes only each `step`-th of the camera's frames.

    `real` is the clock of patience and grace, seconds; `event` wakes the waiting threads.
    """

    def __init__(
        self, period_s: float, *, step: int = 1, patience_s: float = PATIENCE_S, grace_s: float = GRACE_S,
        real: Callable[[], float] = time.monotonic, event: WakeEvent | None = None,
    ) -> None:  # fmt: skip
        self._period_s, self._step, self._patience_s, self._grace_s = period_s, step, patience_s, grace_s
        self._is_over, self._real = False, real
        self._lock, self._changed = threading.Lock(), event or WakeEvent()
        self._frame, self._seen = 0, 0
        self._spoken_s, self._heard_s = -1.0, -1.0
        self._made_s, self._is_drawn = self._real(), True

    def now(self) -> float:
        with self._lock:
            now_s = self._now()
        return now_s

    def _now(self) -> float:
        alone_s = max(0.0, self._real() - self._made_s - self._grace_s) if self._is_drawn else 0.0
        return self._frame * self._period_s + alone_s

    def sleep(self, duration_s: float) -> None:
        end_s = self.now() + duration_s
        while not self._changed.wait_for(lambda: self.now() >= end_s, POLL_S):
            pass

    def has_seen(self, frame: int) -> None:
        with self._lock:
            self._seen = max(self._seen, frame)
        self._changed.set()

    def has_spoken(self) -> None:
        with self._lock:
            self._spoken_s = self._now()

    def has_heard(self, reading_s: float) -> None:
        with self._lock:
            self._heard_s = max(self._heard_s, reading_s)
        self._changed.set()

    def next_frame(self) -> int:
        """Waits until the host has read all of the frame before; time is that of the frame of this number from now."""
        self._changed.wait_for(self._is_read, self._patience_s if self._seen else FIRST_S)
        with self._lock:
            self._frame = made = int(self._now() / self._period_s + 1e-6) + self._step
            self._made_s, self._is_drawn = self._real(), False
        self._changed.set()
        return made

    def has_drawn(self) -> None:
        """The frame is there, and is sent now. Time that went on without it goes on."""
        with self._lock:
            if not self._is_drawn:
                self._made_s, self._is_drawn = self._real(), True

    def without_frames(self) -> None:
        """The camera has gone or stands still: until the next frame time runs at its real pace."""
        with self._lock:
            without_grace_s = self._real() - self._grace_s
            self._made_s = min(self._made_s, without_grace_s) if self._is_drawn else without_grace_s
            self._is_drawn = True
        self._changed.set()

    def stop(self) -> None:
        """Nobody reads any more: no frame waits from now on."""
        self._is_over = True
        self._changed.set()

    def _is_read(self) -> bool:
        with self._lock:
            return self._is_over or (self._seen >= self._frame and self._heard_s >= self._spoken_s)
