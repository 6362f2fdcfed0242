"""Guards against a test that hangs: far beyond what anything takes on a busy computer, never an expectation."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TypeVar

T = TypeVar("T")

HANG_S = 120.0
LOOK_S = 0.002  # between two looks at what is awaited


def until(look: Callable[[], T], what: str) -> T:
    """The first true thing that `look` returns; fails with `what` was awaited where the test hangs."""
    end_s = time.monotonic() + HANG_S
    while not (seen := look()):
        assert time.monotonic() < end_s, f"hangs: waited {HANG_S:.0f} s for {what}"
        time.sleep(LOOK_S)
    return seen


@contextlib.contextmanager
def guard(what: str) -> Iterator[None]:
    """Inside, the main thread may wait for anything; fails with `what` was awaited where the test hangs."""

    def hangs(_: int, __: FrameType | None) -> None:
        raise AssertionError(f"hangs: waited {HANG_S:.0f} s for {what}")

    before, was_s = signal.signal(signal.SIGALRM, hangs), time.monotonic()
    left_s, _ = signal.setitimer(signal.ITIMER_REAL, HANG_S)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
        # A guard round this one goes on.
        signal.setitimer(signal.ITIMER_REAL, max(left_s - (time.monotonic() - was_s), 1.0) if left_s else 0)
