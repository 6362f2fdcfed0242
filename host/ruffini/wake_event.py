"""An event that wakes waiting threads and survives Ctrl-C.

A KeyboardInterrupt may arrive after any call of the main thread. `threading.Condition` acquires its lock in Python
code, so an interrupt right there leaves it locked forever and the next thread that notifies blocks (`ruffini monitor`
then took the 5 s of `Sensor.close` to end, once in 400 runs). Here no lock is held while a thread waits; the state that
`condition` reads is guarded by a plain `threading.Lock` in a `with`, which is acquired and released atomically.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")


class WakeEvent:
    """Change the shared state, then call `set`: waiting threads check it again. Do not hold a lock while waiting."""

    def __init__(self) -> None:
        self._waiting: list[SimpleQueue[None]] = []

    def set(self) -> None:
        """Wake all threads that wait now."""
        for place in tuple(self._waiting):
            place.put(None)

    def wait_for(self, condition: Callable[[], T], timeout_s: float | None = None) -> T:
        """Wait until `condition()` is true and return its value; after `timeout_s`, return its last value."""
        if seen := condition():
            return seen
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        place: SimpleQueue[None] = SimpleQueue()
        try:
            self._waiting.append(place)  # before the check that counts: a later change wakes this thread
            while not (seen := condition()):
                left_s = None if end_s is None else end_s - time.monotonic()
                if left_s is not None and left_s <= 0:
                    return seen
                with contextlib.suppress(Empty):
                    place.get(timeout=left_s)
            return seen
        finally:
            with contextlib.suppress(ValueError):
                self._waiting.remove(place)
