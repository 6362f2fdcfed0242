"""Messages that came while nobody took them: bounded by number and by bytes, the oldest go."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Any

from ruffini.wire import Frame

MAX_MESSAGES = 4096
MAX_BYTES = 64 << 20  # of payloads as they came: 16 s of a line that brings 4 MB/s


class Backlog:
    """A queue that keeps the newest.

    Attributes
    ----------
    n_added, n_dropped : messages that were put in, and that went because of a bound.
    """

    def __init__(self, max_messages: int = MAX_MESSAGES, max_bytes: int = MAX_BYTES) -> None:
        self._max_messages, self._max_bytes = max_messages, max_bytes
        self._waiting: deque[tuple[Frame, Any]] = deque()
        self._n_bytes = 0
        self.n_added = 0
        self.n_dropped = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def append(self, frame: Frame, message: Any) -> None:
        """Put in the newest; one alone stays, however large it is."""
        self._waiting.append((frame, message))
        self._n_bytes += len(frame.payload)
        self.n_added += 1
        while len(self) > self._max_messages or (self._n_bytes > self._max_bytes and len(self) > 1):
            self.popleft()
            self.n_dropped += 1

    def popleft(self) -> tuple[Frame, Any]:
        """Take out the oldest."""
        frame, message = self._waiting.popleft()
        self._n_bytes -= len(frame.payload)
        return frame, message

    def take(self, is_wanted: Callable[[Frame, Any], bool], seen: int = 0) -> Any | None:
        """Take out the oldest message that is wanted, of those that were added after the first `seen`."""
        first = max(len(self) - (self.n_added - seen), 0)
        for i, (frame, message) in enumerate(islice(self._waiting, first, None), first):
            if is_wanted(frame, message):
                del self._waiting[i]
                self._n_bytes -= len(frame.payload)
                return message
        return None
