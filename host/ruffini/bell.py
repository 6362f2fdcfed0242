"""Waking threads that wait, also where Ctrl-C comes in between.

A KeyboardInterrupt may come after any call that the main thread makes. `threading.Condition` takes its lock within
Python code: one that comes right there leaves it taken for good, and the thread that would ring next stands still
(`ruffini monitor` took the 5 s of `Sensor.close` to end, once in 400 times). Here nothing is held while anybody waits;
what `look` reads is guarded by a plain `threading.Lock` in a `with`, which is taken and given back in one step.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")


class Bell:
    """Change something, then `ring`: whoever waits looks again. Any thread; no lock may be held while waiting."""

    def __init__(self) -> None:
        self._waiting: list[SimpleQueue[None]] = []

    def ring(self) -> None:
        """Wake all who wait now."""
        for place in tuple(self._waiting):
            place.put(None)

    def wait_for(self, look: Callable[[], T], timeout_s: float | None = None) -> T:
        """What `look` returns once that is true; what it returned last where `timeout_s` ends before."""
        if seen := look():
            return seen
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        place: SimpleQueue[None] = SimpleQueue()
        try:
            self._waiting.append(place)  # before the look that counts: what changes after it rings here
            while not (seen := look()):
                left_s = None if end_s is None else end_s - time.monotonic()
                if left_s is not None and left_s <= 0:
                    return seen
                with contextlib.suppress(Empty):
                    place.get(timeout=left_s)
            return seen
        finally:
            with contextlib.suppress(ValueError):
                self._waiting.remove(place)
