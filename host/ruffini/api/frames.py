"""Frames that wait for whoever takes them: a bounded queue between the reading thread and the program."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from ruffini.api.frame import SensorFrame
from ruffini.bell import Bell
from ruffini.device.line_gap import LineGap


class Frames:
    """An iterator over a sensor's frames, from the moment it was asked for.

    At most `capacity` frames wait; the oldest goes where a newer one finds no room (capacity 1: the newest wins), and
    the next frame's `n_missed` counts it. Ends when the sensor is closed; a sensor that is gone raises what happened.
    """

    def __init__(self, capacity: int, sensor: int | None, *, partial: bool = False) -> None:
        self._waiting: deque[SensorFrame] = deque(maxlen=capacity)
        self._sensor, self._partial = sensor, partial
        self._gap: LineGap | None = None  # before a frame that was not given out
        self._lock, self._changed = threading.Lock(), Bell()  # of all that both threads change
        self._end: BaseException | None = None
        self._before: dict[int, int] = {}  # by sensor: the frame that was taken last
        self.n_partial = 0  # frames of which a part was lost on the way, and which were not wanted
        self.n_replaced = 0  # frames that a newer one replaced before they were taken
        self.wake: Callable[[], None] = lambda: None  # called by the reading thread whenever something changed

    def __iter__(self) -> Frames:
        return self

    def __next__(self) -> SensorFrame:
        frame = self._changed.wait_for(self._take)
        assert frame is not None
        return frame

    def get(self, timeout_s: float) -> SensorFrame | None:
        """The next frame; None where none comes in time. StopIteration at the end, as `next` does."""
        return self._changed.wait_for(self._take, timeout_s)

    def _take(self) -> SensorFrame | None:
        with self._lock:
            if not self._waiting:
                if self._end is not None:
                    raise self._end
                return None
            frame = self._waiting.popleft()
            before = self._before.get(frame.sensor)
            self._before[frame.sensor] = frame.number
        is_new = before is None or frame.number < before
        return replace(frame, n_missed=None if is_new or before is None else max(frame.number - before - 1, 0))

    # ---- the reading thread -------------------------------------------------------------------

    def put(self, frame: SensorFrame) -> None:
        """One more frame."""
        if self._sensor is not None and frame.sensor not in (self._sensor, 255):
            return
        if not (frame.is_whole or frame.is_stale or self._partial):
            self.n_partial += 1
            self._gap = frame.gap or self._gap
            return
        if self._gap is not None and not frame.is_stale:
            frame, self._gap = replace(frame, gap=frame.gap or self._gap), None
        with self._lock:
            self.n_replaced += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(frame)
        self._changed.ring()
        self.wake()

    def end(self, reason: BaseException) -> None:
        """No more will come: StopIteration, or what went wrong."""
        with self._lock:
            self._end = reason
        self._changed.ring()
        self.wake()
