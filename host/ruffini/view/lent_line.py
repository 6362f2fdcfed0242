"""A sensor's line that this program itself reads and writes: pages look on, and are shown its work."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Iterable
from typing import Any

from ruffini.device import Connection
from ruffini.errors import RuffiniError
from ruffini.patience import PATIENCE
from ruffini.view.line import Line
from ruffini.view.outbox import Outbox
from ruffini.wire import Frame, Schema

TELL_S = 0.1  # between two states
GOODBYE_S = 2.0  # real: that long a page has time to take the last one; times PATIENCE
ANSWERS = ("HELLO", "SCHEMA", "REPLY", "TIME")  # belong to the owner of the line
BUSY = "a collection goes on with this sensor: its page only looks on; end it first"


class Refusal:
    """Answers commands of pages while nobody passes them on to the sensor.

    A page may subscribe, which changes nothing, and is refused all else in a sentence.
    """

    def __init__(self, schema: Schema, why: str) -> None:
        self.schema, self._why = schema, why
        self._sequence = 0

    def forwards(self, frame: Frame) -> bool:
        """True if a frame of the sensor is for pages, too."""
        return True

    def hear(self, box: Outbox, frame: Frame) -> None:
        """A page's message."""
        if self.schema.type_name(frame.type) == "COMMAND":
            with contextlib.suppress(RuffiniError):
                self._reply(box, self.schema.decode(frame.type, frame.payload))

    def _reply(self, box: Outbox, command: Any) -> None:
        is_subscribe = command.WhichOneof("action") == "subscribe"
        code, text = ("REPLY_OK", "") if is_subscribe else ("REPLY_BUSY", self._why)
        number = self.schema.enum_number("ReplyCode", code)
        self._answer(box, "REPLY", self.schema.new("Reply", request_id=command.request_id, code=number, text=text))

    def _answer(self, box: Outbox, name: str, message: Any) -> None:
        number = self.schema.type_numbers[name]
        box.put(Frame(number, 255, self._sequence, 0, message.SerializeToString()), self.schema)
        self._sequence += 1


class StandIn(Refusal):
    """Answers pages in the place of a sensor that somebody else reads and writes: also HELLO and SCHEMA."""

    def __init__(self, sensor: Connection) -> None:
        super().__init__(sensor.schema, BUSY)
        self._sensor = sensor
        self._passed_over = {sensor.schema.type_numbers.get(name) for name in ANSWERS}

    def forwards(self, frame: Frame) -> bool:
        return frame.type not in self._passed_over

    def hear(self, box: Outbox, frame: Frame) -> None:
        name = self.schema.type_name(frame.type)
        if name == "HELLO":
            self._answer(box, name, self._sensor.hello)
        elif name == "SCHEMA":
            self._answer(box, name, self.schema.new("Schema", file_descriptor_set=self.schema.bytes))
        else:
            super().hear(box, frame)


def show_guide(boxes: Iterable[Outbox], state: Callable[[], dict[str, Any]]) -> None:
    """Send the state of a collection to pages; it is looked at only if there is one."""
    if boxes := list(boxes):
        text = json.dumps({"kind": "guide", **state()})
        for box in boxes:
            box.put_text("guide", text)


async def show_guide_always(boxes: Iterable[Outbox], state: Callable[[], dict[str, Any]]) -> None:
    """`show_guide` every `TELL_S`."""
    while True:
        show_guide(boxes, state)
        await asyncio.sleep(TELL_S)


class LentLine(Line):
    """Its frames are those that the owner of the `Connection` asked for, as they come.

    Parameters
    ----------
    tell : the owner's state, as JSON takes it; called in the server's thread.
    hear : what a page answers ("done" or "stop"), to which question, and what was typed.
    """

    def __init__(
        self, sensor: Connection, tell: Callable[[], dict[str, Any]], hear: Callable[[str, int, str], None]
    ) -> None:
        super().__init__(sensor.port, sensor.schema)
        self._sensor, self._tell_state, self._hear = sensor, tell, hear
        self._stand_in = StandIn(sensor)
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        self._loop, self._problem = asyncio.get_running_loop(), ""
        self._sensor.raw_sink = lambda data: self.tell(self._receive, data)
        self._task = asyncio.create_task(show_guide_always(self.boxes, self._tell_state))

    async def close(self) -> None:
        self._sensor.raw_sink = None
        assert self._task is not None
        if self._task.done():
            self._task.result()  # raises what ended it
        self._task.cancel()

    async def say_goodbye(self) -> None:
        self._sensor.raw_sink = None  # a box that frames go on filling is never empty
        show_guide(self.boxes, self._tell_state)

        async def emptied() -> None:
            while not all(box.is_empty for box in self.boxes):
                await asyncio.sleep(TELL_S / 10)

        with contextlib.suppress(asyncio.TimeoutError):  # Python 3.10's own
            await asyncio.wait_for(emptied(), GOODBYE_S * PATIENCE)

    def _put(self, box: Outbox, frame: Frame) -> None:
        if self._stand_in.forwards(frame):
            super()._put(box, frame)

    def hear(self, told: dict[str, Any]) -> None:
        if answer := answer_in(told):
            self._hear(*answer)

    async def send(self, box: Outbox, frame: Frame) -> None:
        self._stand_in.hear(box, frame)


def answer_in(told: dict[str, Any]) -> tuple[str, int, str] | None:
    """A page's answer to a question, the question's number, and what was typed; None if it is no such answer."""
    word, number, typed = told.get("guide"), told.get("asked", 0), told.get("typed", "")
    if word in ("done", "stop") and isinstance(number, int) and isinstance(typed, str):
        return str(word), number, typed
    return None
