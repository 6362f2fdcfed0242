"""When a line is damaged so often that the CRC alone is no promise any more (proto/README.md)."""

from __future__ import annotations

from collections import deque

# Between damaged frames: ten an hour, of which 1 in 2^32 goes unseen, make 2.3e-9 wrong frames an hour.
INTERVAL_S = 360.0


class DamageWatch:
    """Two damaged frames within six minutes: the line is no longer good enough to steer by."""

    def __init__(self) -> None:
        self._seen: deque[float] = deque(maxlen=2)  # when the last two came
        self._n = 0

    def update(self, n_damaged: int, now_s: float) -> bool:
        """Tell of all frames that came damaged so far; True when that makes the line bad which it was not before."""
        was_bad = self.is_bad(now_s)
        new = max(n_damaged - self._n, 0)
        self._n = n_damaged
        self._seen.extend([now_s] * min(new, 2))
        return not was_bad and self.is_bad(now_s)

    def begin_decoder(self) -> None:
        """A new decoder has replaced the last one: it counts from 0."""
        self._n = 0

    def is_bad(self, now_s: float) -> bool:
        """Were there two within the last six minutes?"""
        return len(self._seen) == 2 and now_s - self._seen[0] < INTERVAL_S
