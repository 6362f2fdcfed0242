"""A sensor's line that this program itself reads and writes: pages look on, and are told what it is at."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any

from ruffini.device import Connection
from ruffini.errors import RuffiniError
from ruffini.view.line import Line
from ruffini.view.outbox import Outbox
from ruffini.wire import Frame

TELL_S = 0.1  # between two states
GOODBYE_S = 2.0  # real: that long a page has time to take the last one
ANSWERS = ("HELLO", "SCHEMA", "REPLY", "TIME")  # belong to the owner of the line
BUSY = "a collection goes on with this sensor: its page only looks on; end it first"


class LentLine(Line):
    """Its frames are those that the owner of the `Connection` asked for, as they come.

    HELLO and SCHEMA are answered here; a page may subscribe, which changes nothing, and is refused all else.

    Parameters
    ----------
    tell : what the owner is at now, as JSON takes it; called in the server's thread.
    hear : what a page answers ("done" or "stop"), to which question, and what was typed.
    """

    def __init__(
        self, sensor: Connection, tell: Callable[[], dict[str, Any]], hear: Callable[[str, int, str], None]
    ) -> None:
        super().__init__(sensor.port, sensor.schema)
        self._sensor, self._tell_state, self._hear = sensor, tell, hear
        self._passed_over = {sensor.schema.type_numbers.get(name) for name in ANSWERS}
        self._task: asyncio.Task[None] | None = None
        self._sequence = 0

    async def start(self) -> None:
        self._loop, self._problem = asyncio.get_running_loop(), ""
        self._sensor.raw_sink = lambda data: self.tell(self._receive, data)
        self._task = asyncio.create_task(self._tell_for_ever())

    async def close(self) -> None:
        self._sensor.raw_sink = None
        assert self._task is not None
        if self._task.done():
            self._task.result()  # raises what ended it
        self._task.cancel()

    async def say_goodbye(self) -> None:
        self._say()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(GOODBYE_S):
                while not all(box.is_empty for box in self.boxes):
                    await asyncio.sleep(TELL_S / 10)

    async def _tell_for_ever(self) -> None:
        while True:
            self._say()
            await asyncio.sleep(TELL_S)

    def _say(self) -> None:
        if self.boxes:
            text = json.dumps({"kind": "guide", **self._tell_state()})
            for box in self.boxes:
                box.put_text("guide", text)

    def _put(self, box: Outbox, frame: Frame) -> None:
        if frame.type not in self._passed_over:
            super()._put(box, frame)

    def hear(self, told: dict[str, Any]) -> None:
        word, number = told["guide"], told.get("asked", 0)
        typed = told.get("typed", "")
        if word in ("done", "stop") and isinstance(number, int) and isinstance(typed, str):
            self._hear(word, number, typed)

    async def send(self, box: Outbox, frame: Frame) -> None:
        name = self._schema.type_name(frame.type)
        if name == "HELLO":
            self._answer(box, name, self._sensor.hello)
        elif name == "SCHEMA":
            self._answer(box, name, self._schema.new("Schema", file_descriptor_set=self._schema.bytes))
        elif name == "COMMAND":
            with contextlib.suppress(RuffiniError):
                self._reply(box, self._schema.decode(frame.type, frame.payload))

    def _reply(self, box: Outbox, command: Any) -> None:
        is_subscribe = command.WhichOneof("action") == "subscribe"
        code, text = ("REPLY_OK", "") if is_subscribe else ("REPLY_BUSY", BUSY)
        number = self._schema.enum_number("ReplyCode", code)
        self._answer(box, "REPLY", self._schema.new("Reply", request_id=command.request_id, code=number, text=text))

    def _answer(self, box: Outbox, name: str, message: Any) -> None:
        number = self._schema.type_numbers[name]
        box.put(Frame(number, 255, self._sequence, 0, message.SerializeToString()), self._schema)
        self._sequence += 1
