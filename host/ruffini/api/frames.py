"""A bounded queue of frames between the reading thread and the program."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from ruffini.api.frame import SensorFrame
from ruffini.device.line_gap import LineGap
from ruffini.wake_event import WakeEvent


class Frames:
    """An iterator over a sensor's frames, starting at its creation.

    At most `capacity` frames wait; a new frame replaces the oldest if the queue is full, and the next frame's
    `n_missed` counts it. Iteration ends when the sensor is closed; if the sensor is lost, it raises the reason.
    """

    def __init__(self, capacity: int, sensor: int | None, *, partial: bool = False) -> None:
        self._waiting: deque[SensorFrame] = deque(maxlen=capacity)
        self._sensor, self._partial = sensor, partial
        self._gap: LineGap | None = None  # before a frame that was dropped
        self._lock, self._changed = threading.Lock(), WakeEvent()  # guard the state shared by both threads
        self._end: BaseException | None = None
        self._before: dict[int, int] = {}  # by sensor: number of the last frame taken
        self.n_partial = 0  # frames dropped because a part was lost on the line
        self.n_replaced = 0  # frames replaced by a newer one before they were taken
        self.wake: Callable[[], None] = lambda: None  # called by the reading thread on every change

    def __iter__(self) -> Frames:
        return self

    def __next__(self) -> SensorFrame:
        frame = self._changed.wait_for(self._take)
        assert frame is not None
        return frame

    def get(self, timeout_s: float) -> SensorFrame | None:
        """The next frame, None if none comes in time; raises StopIteration at the end, as `next` does."""
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
        """Add a frame."""
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
        self._changed.set()
        self.wake()

    def end(self, reason: BaseException) -> None:
        """End the iteration with StopIteration or with the error that ended the stream."""
        with self._lock:
            self._end = reason
        self._changed.set()
        self.wake()
