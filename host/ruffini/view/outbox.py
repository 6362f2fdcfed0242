"""What waits for one page: answers in order, of all else the newest."""

from __future__ import annotations

import asyncio
from collections import deque

from ruffini.wire import Frame, Schema, encode_message

MAX_ANSWERS = 256  # a page that takes none of them any more loses the oldest


class Outbox:
    """Messages for a page. Answers and events wait in order; of a result only the newest waits.

    Not for several threads: all of it runs in the server's loop.
    """

    def __init__(self) -> None:
        self._answers: deque[bytes] = deque(maxlen=MAX_ANSWERS)
        self._newest: dict[tuple[int, int], bytes] = {}
        self._texts: dict[str, str] = {}
        self._ready = asyncio.Event()
        self.n_dropped = 0  # messages that a newer one replaced before the page took them

    def put(self, frame: Frame, schema: Schema) -> None:
        """One message of the device."""
        data = encode_message(frame.type, frame.payload, sensor=frame.sensor, sequence=frame.sequence,
                              flags=frame.flags)  # fmt: skip
        if schema.is_result(frame.type):
            key = (frame.sensor, frame.type)
            self.n_dropped += key in self._newest
            self._newest.pop(key, None)  # to the end: messages go out in the order in which they came
            self._newest[key] = data
        else:
            self._answers.append(data)
        self._ready.set()

    def put_text(self, kind: str, text: str) -> None:
        """A line of JSON of the server's own; the newest of each kind waits."""
        self._texts[kind] = text
        self._ready.set()

    @property
    def is_empty(self) -> bool:
        """Has the page taken all of it?"""
        return not (self._answers or self._newest or self._texts)

    async def take(self) -> tuple[list[str], bytes]:
        """All that waits, as soon as something does."""
        await self._ready.wait()
        self._ready.clear()
        texts, data = list(self._texts.values()), b"".join([*self._answers, *self._newest.values()])
        self._texts.clear()
        self._answers.clear()
        self._newest.clear()
        return texts, data
