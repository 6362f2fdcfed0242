"""Times of the host's monotonic clock on its system clock, which other programs stamp by."""

from __future__ import annotations

import time

LOOKS = 5


class SystemClock:
    """Times of `time.monotonic_ns` on the system clock, `time.time_ns`.

    What is between both is looked up once a second: the system clock may be set meanwhile.
    """

    def __init__(self) -> None:
        self._offset_ns, self._due_ns = 0, 0

    def from_monotonic(self, host_ns: int) -> int:
        now_ns = time.monotonic_ns()
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + 1_000_000_000
            self._offset_ns = min(self._look() for _ in range(LOOKS))[1]
        return host_ns + self._offset_ns

    @staticmethod
    def _look() -> tuple[int, int]:
        """(how long it took, offset): the shortest look says most."""
        before, system, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        return after - before, system - (before + after) // 2
