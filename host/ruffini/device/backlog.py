"""A queue of unread messages, bounded by number and bytes; the oldest are dropped."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Any

from ruffini.wire import Frame

MAX_MESSAGES = 4096
MAX_BYTES = 64 << 20  # of encoded payloads: 16 s of a line at 4 MB/s


class Backlog:
    """A bounded queue that keeps the newest messages.

    Attributes
    ----------
    n_added, n_dropped : number of messages added, and dropped because of a bound.
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
        """Add the newest message; a single message is kept whatever its size."""
        self._waiting.append((frame, message))
        self._n_bytes += len(frame.payload)
        self.n_added += 1
        while len(self) > self._max_messages or (self._n_bytes > self._max_bytes and len(self) > 1):
            self.popleft()
            self.n_dropped += 1

    def popleft(self) -> tuple[Frame, Any]:
        """Remove and return the oldest message."""
        frame, message = self._waiting.popleft()
        self._n_bytes -= len(frame.payload)
        return frame, message

    def clear(self) -> None:
        """Remove all messages."""
        self._waiting.clear()
        self._n_bytes = 0

    def take(self, is_wanted: Callable[[Frame, Any], bool], seen: int = 0) -> Any | None:
        """Remove and return the oldest wanted message, ignoring the first `seen` messages ever added; None if none."""
        first = max(len(self) - (self.n_added - seen), 0)
        for i, (frame, message) in enumerate(islice(self._waiting, first, None), first):
            if is_wanted(frame, message):
                del self._waiting[i]
                self._n_bytes -= len(frame.payload)
                return message
        return None
