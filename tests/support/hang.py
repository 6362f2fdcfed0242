"""Guards against a test that hangs: far beyond what anything takes, never an expectation.

Time for which threads of the test, or of a process that it started, were ready and had no core does not count: on a
computer with twenty programs for two cores all takes ten times as long, and nothing hangs. It is summed over threads,
since a frame goes from one to the next and waits for a core at each.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

HANG_S = 120.0
MOST = 10  # times as long, at most: on a busy computer threads that only look round lose time for ever
LOOK_S = 0.002  # between two looks at what is awaited
LEAST_S = 0.1  # between two looks at whether it hangs
FIRST_S = 1.0  # before it, nobody looks: most waits are over, and a look reads a file of each thread


class Patience:
    """Begins when it is made."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()
        self._before: dict[str, float] | None = None
        self._next_s = self._start_s + FIRST_S

    def left_s(self) -> float:
        """Seconds that the test may still wait."""
        now = _without_core_s()
        before = self._before = now if self._before is None else self._before
        lost_s = sum(max(s - before.get(thread, 0), 0) for thread, s in now.items())
        return min(HANG_S + lost_s, MOST * HANG_S) - (time.monotonic() - self._start_s)

    def is_over(self) -> bool:
        """May be asked often."""
        if time.monotonic() < self._next_s:
            return False
        left_s = self.left_s()
        self._next_s = time.monotonic() + max(left_s, LEAST_S)
        return left_s <= 0


def _without_core_s(process: str = "self") -> dict[str, float]:
    """Of each thread of a process and of its descendants: for how long it was ready and had no core, seconds.

    Empty where the kernel does not count it.
    """
    found: dict[str, float] = {}
    with contextlib.suppress(OSError):  # it ends meanwhile
        for thread in Path(f"/proc/{process}/task").iterdir():
            with contextlib.suppress(OSError):
                _, waited_ns, _ = (thread / "schedstat").read_text().split()
                found[thread.name] = 1e-9 * int(waited_ns)
                for child in (thread / "children").read_text().split():
                    found |= _without_core_s(child)
    return found


def until(look: Callable[[], T], what: str) -> T:
    """The first true thing that `look` returns; fails with `what` was awaited where the test hangs."""
    patience = Patience()
    while not (seen := look()):
        assert not patience.is_over(), f"hangs: waited {HANG_S:.0f} s for {what}"
        time.sleep(LOOK_S)
    return seen


@contextlib.contextmanager
def guard(what: str) -> Iterator[None]:
    """Inside, the main thread may wait for anything; fails with `what` was awaited where the test hangs."""
    patience = Patience()

    def hangs(_: int, __: FrameType | None) -> None:
        left_s = patience.left_s()
        if left_s <= 0:
            raise AssertionError(f"hangs: waited {HANG_S:.0f} s for {what}")
        signal.setitimer(signal.ITIMER_REAL, max(left_s, LEAST_S))

    before, was_s = signal.signal(signal.SIGALRM, hangs), time.monotonic()
    outer_s, _ = signal.setitimer(signal.ITIMER_REAL, patience.left_s())
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
        # A guard round this one goes on.
        signal.setitimer(signal.ITIMER_REAL, max(outer_s - (time.monotonic() - was_s), 1.0) if outer_s else 0)


def finished(command: Sequence[str | Path], **options: Any) -> subprocess.CompletedProcess[str]:
    """A command that has ended, with its output; fails where it hangs."""
    with guard(" ".join(map(str, command))):
        return subprocess.run(command, capture_output=True, text=True, check=False, **options)
