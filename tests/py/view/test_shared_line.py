"""What the viewer's server does with a line and its pages: newest only, subscriptions united, doors shut."""

from __future__ import annotations

import asyncio
import json
import os
import select
import tty
from collections.abc import Iterator
from typing import Any

import aiohttp
import pytest
from hang import HANG_S

from ruffini.errors import NoDeviceError
from ruffini.view.calibrating_line import HANDED_OVER, CalibratingLine
from ruffini.view.line import SharedLine
from ruffini.view.outbox import MAX_ANSWERS, Outbox
from ruffini.view.server import IN_FLIGHT, serve
from ruffini.wire import Decoder, Frame, Schema, encode_message

SCHEMA = Schema.own()
NUMBER = SCHEMA.type_numbers
N_FIELDS = 100
QUIET_S = 0.2  # in which what must not come would come


def frame(name: str, sequence: int, payload: bytes = b"", sensor: int = 0) -> Frame:
    return Frame(NUMBER[name], sensor, sequence, 2, payload)


def taken(box: Outbox) -> list[tuple[str | None, int, int]]:
    _, data = asyncio.run(box.take())
    return [(SCHEMA.type_name(f.type), f.sensor, f.sequence) for f in Decoder().feed(data)]


def test_of_results_the_newest_waits_and_answers_all_wait() -> None:
    box = Outbox()
    for i, name in enumerate(["WRENCH", "FIELD", "REPLY", "WRENCH", "EVENT", "STATUS", "REPLY", "STATUS"]):
        box.put(frame(name, i), SCHEMA)
    box.put(frame("WRENCH", 9, sensor=1), SCHEMA)
    assert taken(box) == [("REPLY", 0, 2), ("EVENT", 0, 4), ("REPLY", 0, 6), ("FIELD", 0, 1), ("WRENCH", 0, 3),
                          ("STATUS", 0, 7), ("WRENCH", 1, 9)]  # fmt: skip
    assert box.n_dropped == 2


def test_a_page_that_takes_nothing_holds_no_more_than_its_due() -> None:
    box = Outbox()
    for i in range(10_000):
        box.put(frame("REPLY", i), SCHEMA)
        box.put(frame("FIELD", i, b"x" * 4000), SCHEMA)
    got = taken(box)
    assert len(got) == MAX_ANSWERS + 1
    assert got[0] == ("REPLY", 0, 10_000 - MAX_ANSWERS)
    assert got[-1] == ("FIELD", 0, 9_999)


class Device:
    """The other end of a pty."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._decoder = Decoder(from_host=True)

    def close(self) -> None:
        os.close(self.master)
        os.close(self._slave)

    def heard(self, n: int) -> list[Frame]:
        """At least n frames."""
        out: list[Frame] = []
        while len(out) < n:
            assert select.select([self.master], [], [], HANG_S)[0], f"hangs: {len(out)} of {n} frames came"
            out += self._decoder.feed(os.read(self.master, 65_536))
        return out

    def say(self, name: str, sequence: int, payload: bytes = b"") -> int:
        """How many bytes it said."""
        return os.write(self.master, encode_message(NUMBER[name], payload, sensor=0, sequence=sequence, flags=2))


@pytest.fixture
def device() -> Iterator[Device]:
    device = Device()
    yield device
    device.close()


def subscribe(request: int, **every: int) -> Frame:
    subscriptions = [{"type": NUMBER[name.upper()], "every": n} for name, n in every.items()]
    command = SCHEMA.new("Command", request_id=request, subscribe={"subscriptions": subscriptions})
    return Frame(NUMBER["COMMAND"], 255, 0, 1, command.SerializeToString())


def test_the_device_is_asked_for_what_any_page_wants(device: Device) -> None:
    async def two_pages() -> list[Frame]:
        line, one, other = SharedLine(device.port), Outbox(), Outbox()
        await line.start()
        line.boxes = {one: {}, other: {}}
        await line.send(one, subscribe(7, wrench=1, field=4))
        await line.send(other, subscribe(8, field=2, image=6))
        await line.leave(one)
        await line.close()
        return device.heard(3)

    said = []
    frames = asyncio.run(two_pages())
    for f in frames:
        command = SCHEMA.decode(f.type, f.payload)
        said.append((command.request_id, {s.type: s.every for s in command.subscribe.subscriptions}))  # type: ignore[union-attr]
    wrench, field, image = NUMBER["WRENCH"], NUMBER["FIELD"], NUMBER["IMAGE"]
    assert said == [(7, {wrench: 1, field: 4}), (8, {wrench: 1, field: 2, image: 6}), (0, {field: 2, image: 6})]
    assert [f.sequence for f in frames] == [0, 1, 2]


def zero(request: int) -> Frame:
    return Frame(NUMBER["COMMAND"], 255, 0, 1, SCHEMA.new("Command", request_id=request, zero={}).SerializeToString())


def test_what_a_page_asks_while_the_line_changes_hands_is_answered_at_once(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    line, box, answers = CalibratingLine(device.port), Outbox(), []

    async def ask(command: Frame) -> None:
        await line.send(box, command)
        _, data = ([], b"") if box.is_empty else await box.take()
        for frame in Decoder().feed(data):
            reply: Any = SCHEMA.decode(frame.type, frame.payload)
            answers.append((reply.request_id, reply.code, reply.text))

    async def use() -> None:
        await line.start()
        line.boxes[box] = {}
        loop = asyncio.get_running_loop()

        def silent(_: str) -> None:
            for command in (zero(1), subscribe(2, wrench=1)):
                asyncio.run_coroutine_threadsafe(ask(command), loop).result(HANG_S)
            line.tell(line._say_lost, "the line was lost: plug the sensor in again")
            asyncio.run_coroutine_threadsafe(ask(zero(5)), loop).result(HANG_S)
            raise NoDeviceError("nothing answers HELLO")

        def calibrate() -> None:
            with pytest.raises(NoDeviceError), line._borrowed():
                pass
            asyncio.run_coroutine_threadsafe(ask(zero(3)), loop).result(HANG_S)

        monkeypatch.setattr("ruffini.view.calibrating_line.Connection", silent)
        await asyncio.to_thread(calibrate)
        while line._problem:
            await asyncio.sleep(0.01)
        await line.send(box, zero(4))
        await line.close()

    asyncio.run(asyncio.wait_for(use(), HANG_S))
    busy = SCHEMA.enum_number("ReplyCode", "REPLY_BUSY")
    lost = "the line was lost: plug the sensor in again"
    assert answers == [(1, busy, HANDED_OVER), (2, 0, ""), (5, busy, lost), (3, busy, HANDED_OVER)]
    (passed_on,) = device.heard(1)
    command: Any = SCHEMA.decode(passed_on.type, passed_on.payload)
    assert command.request_id == 4


def through_the_door(device: Device, work: object, line: SharedLine | None = None) -> object:
    """Run `work(address)` beside the server of the device's line."""

    async def both() -> object:
        stop, address = asyncio.Event(), asyncio.get_running_loop().create_future()
        server = asyncio.create_task(serve([line or SharedLine(device.port)], 0, address.set_result, stop))
        try:
            return await asyncio.wait_for(work(await address), HANG_S)  # type: ignore[operator]
        finally:
            stop.set()
            await server

    return asyncio.run(both())


def test_no_more_is_on_its_way_than_the_page_has_seen(device: Device) -> None:
    line = SharedLine(device.port)

    async def read(address: str) -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{address}line/0") as page:
            decoder, n_said = Decoder(), 0

            async def heard(wait_s: float = HANG_S) -> list[int]:
                """Numbers of the fields in the next message; none where none comes."""
                while True:
                    try:
                        message = await page.receive(timeout=wait_s)
                    except TimeoutError:
                        return []
                    if message.type is aiohttp.WSMsgType.BINARY:
                        return [f.sequence for f in decoder.feed(message.data)]

            for i in range(N_FIELDS):
                n_said += device.say("FIELD", i)
                if i < IN_FLIGHT:
                    assert await heard() == [i]
                while line._n_bytes < n_said:
                    await asyncio.sleep(0.002)
            assert await heard(QUIET_S) == []
            for _ in range(IN_FLIGHT):  # what it has not had yet earns nothing
                await page.send_str(json.dumps({"seen": 99}))
            assert await heard(QUIET_S) == []
            for i in range(1, IN_FLIGHT + 1):
                await page.send_str(json.dumps({"seen": i}))
            assert await heard() == [N_FIELDS - 1]

    through_the_door(device, read, line)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("", {}, 200),
        ("lines.json", {}, 200),
        ("", {"Origin": "https://elsewhere.example"}, 403),
        ("line/0", {"Origin": "https://elsewhere.example"}, 403),
        ("", {"Host": "elsewhere.example"}, 403),
        ("line/7", {}, 404),
        ("../ruffini.desc", {}, 200),
        ("%2e%2e/libruffini.so", {}, 404),
    ],
)
def test_only_its_own_page_gets_in(device: Device, path: str, headers: dict[str, str], status: int) -> None:
    async def ask(address: str) -> int:
        async with aiohttp.ClientSession() as session, session.get(f"{address}{path}", headers=headers) as answer:
            assert status != 200 or "default-src 'self'" in answer.headers["Content-Security-Policy"]
            return answer.status

    assert through_the_door(device, ask) == status


@pytest.mark.parametrize("text", ["", "{", "[]", '{"seen": null}', '{"seen": "x"}', '{"seen": 1e999}', "x" * 8000])
def test_texts_that_are_none_of_ours_are_passed_over(device: Device, text: str) -> None:
    async def talk(address: str) -> bool:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{address}line/0") as line:
            await line.send_str(text)
            await line.send_bytes(os.urandom(4000))
            device.say("FIELD", 1)
            async for message in line:
                if message.type is aiohttp.WSMsgType.BINARY:
                    return True
            return False

    assert through_the_door(device, talk)
