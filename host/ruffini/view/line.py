"""One sensor's line, shared by all pages that look at it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ruffini.device.ports import open_port
from ruffini.device.pty_name import KnownPort
from ruffini.errors import NoDeviceError, RuffiniError
from ruffini.view.outbox import Outbox
from ruffini.wire import Decoder, Frame, Schema, encode_message

REOPEN_S = 0.3
HEALTH_S = 1.0
FIRST_OPEN_S = 5.0


class Line(ABC):
    """What comes over a sensor's line, for all pages that look at it. Runs in the server's loop."""

    calibrates = False  # True if a person may calibrate the sensor from its page

    def __init__(self, port: str, schema: Schema) -> None:
        self.port = port
        self.boxes: dict[Outbox, dict[int, int]] = {}  # what each page subscribed to: message type -> every
        self._schema = schema
        self._decoder = Decoder()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._problem = f"{port} is not open yet"
        self._n_bytes = 0

    @abstractmethod
    async def start(self) -> None:
        """Open it; raises NoDeviceError where it is missing or busy."""

    @abstractmethod
    async def close(self) -> None:
        """Give it back."""

    @abstractmethod
    async def send(self, box: Outbox, frame: Frame) -> None:
        """A page's message."""

    async def leave(self, box: Outbox) -> None:
        """A page has gone."""
        self.boxes.pop(box, None)

    @abstractmethod
    def hear(self, told: dict[str, Any]) -> None:
        """A message of a page, for example the answer to a question."""

    @property
    def report(self) -> Path | None:
        """HTML report on the newest calibration, if one was made from the page."""
        return None

    @abstractmethod
    async def say_goodbye(self) -> None:
        """Before the server ends."""

    def tell(self, function: Any, *arguments: Any) -> None:
        """Call a function in the server's loop, from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            assert self._loop is not None
            self._loop.call_soon_threadsafe(function, *arguments)

    def _receive(self, data: bytes) -> None:
        self._n_bytes += len(data)
        for frame in self._decoder.feed(data):
            for box in self.boxes:
                self._put(box, frame)

    def _put(self, box: Outbox, frame: Frame) -> None:
        box.put(frame, self._schema)

    def state(self) -> str:
        """JSON: is the line open, and if not, why."""
        return json.dumps({"kind": "line", "port": self.port, "open": not self._problem, "text": self._problem})

    async def tell_health(self) -> None:
        """Once a second: what came over the line, and what a slow page did not get."""
        before, since = self._n_bytes, time.monotonic()
        while True:
            await asyncio.sleep(HEALTH_S)
            now = time.monotonic()
            rate, before, since = (self._n_bytes - before) / (now - since), self._n_bytes, now
            for box in self.boxes:
                told = {"kind": "health", "bytes_per_s": round(rate), "not_shown": box.n_dropped,
                        "pages": len(self.boxes), **asdict(self._decoder.counters)}  # fmt: skip
                box.put_text("health", json.dumps(told))


class SharedLine(Line):
    """A serial port, read by a thread of its own, opened again whenever it was lost.

    The device knows one set of subscriptions: it is asked for what any of the pages wants.
    """

    def __init__(self, port: str) -> None:
        super().__init__(port, Schema.own())
        self._serial: Any = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read_for_ever, daemon=True)
        self._known: KnownPort | None = None
        self._sequence = 0
        self._writing = asyncio.Lock()

    async def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._serial = await asyncio.to_thread(open_port, self.port)
        self._known = KnownPort(self.port)
        self._problem = ""
        self._thread.start()

    async def close(self) -> None:
        self._stop.set()
        await asyncio.to_thread(self._thread.join, FIRST_OPEN_S)

    def hear(self, told: dict[str, Any]) -> None:
        """Nobody asks here."""

    async def say_goodbye(self) -> None:
        """A page sees by itself that the server is gone."""

    # ---- another owner of the port, called from its thread --------------------------------------

    def _let_go(self) -> None:
        """Close the port."""
        self._stop.set()
        self._thread.join()

    def _take_back(self) -> None:
        """Open the port again as soon as it is there."""
        self._stop.clear()
        self._thread = threading.Thread(target=self._reopen_and_read, daemon=True)
        self._thread.start()

    # ---- the thread ---------------------------------------------------------------------------

    def _reopen_and_read(self) -> None:
        self._reopen()
        self._read_for_ever()

    def _read_for_ever(self) -> None:
        while not self._stop.is_set():
            try:
                data = self._serial.read(max(self._serial.in_waiting, 1))
                if data:
                    self.tell(self._receive, data)
            except (OSError, TypeError) as error:  # SerialException is an OSError
                self.tell(self._say_lost, f"{self.port}: the line was lost ({error}): plug the sensor in again")
                self._reopen()
        with contextlib.suppress(OSError):
            self._serial.close()

    def _reopen(self) -> None:
        with contextlib.suppress(OSError):
            self._serial.close()
        while not self._stop.wait(REOPEN_S):
            try:
                self._serial = open_port(self.port, self._known)
            except NoDeviceError as error:
                self.tell(self._say_lost, str(error))
                continue
            self._known = KnownPort(self.port)
            self.tell(self._say_open)
            return

    # ---- the loop -----------------------------------------------------------------------------

    def _say_lost(self, problem: str) -> None:
        self._problem = problem
        self._say_state()

    def _say_open(self) -> None:
        self._problem, self._decoder = "", Decoder()
        self._say_state()

    def _say_state(self) -> None:
        for box in self.boxes:
            box.put_text("line", self.state())

    # ---- what pages send ----------------------------------------------------------------------

    async def send(self, box: Outbox, frame: Frame) -> None:
        """A page's message, on to the device; what it subscribes to is united with what the others want."""
        payload = frame.payload
        if frame.type == self._schema.type_numbers["COMMAND"]:
            payload = self._united(box, payload)
        await self._write(frame.type, payload)

    async def leave(self, box: Outbox) -> None:
        """A page has gone; the device sends no more than the others want."""
        wanted = self.boxes.pop(box, {})
        if wanted and self.boxes:
            # Its reply is nobody's: no page waits for request 0.
            command = self._schema.new("Command", request_id=0, subscribe=self._subscriptions())
            await self._write(self._schema.type_numbers["COMMAND"], command.SerializeToString())

    def _united(self, box: Outbox, payload: bytes) -> bytes:
        try:
            command: Any = self._schema.decode(self._schema.type_numbers["COMMAND"], payload)
        except RuffiniError:
            return payload  # the device says what it thinks of it
        if command.WhichOneof("action") != "subscribe":
            return payload
        self.boxes[box] = {s.type: s.every for s in command.subscribe.subscriptions if s.every}
        command.subscribe.CopyFrom(self._subscriptions())
        return bytes(command.SerializeToString())

    def _subscriptions(self) -> Any:
        every: dict[int, int] = {}
        for wanted in self.boxes.values():
            for type_, n in wanted.items():
                every[type_] = min(n, every.get(type_, n))
        return self._schema.new("Subscribe", subscriptions=[{"type": t, "every": n} for t, n in every.items()])

    async def _write(self, type_: int, payload: bytes) -> None:
        if self._problem:
            return  # the page has been told
        async with self._writing:
            # A zero byte first: what was lost may have been the end of a frame.
            data = b"\0" + encode_message(type_, payload, sensor=255, sequence=self._sequence)
            self._sequence += 1
            with contextlib.suppress(OSError, TypeError):  # lost or closed meanwhile: the reading thread sees it, too
                await asyncio.to_thread(self._serial.write, data)
