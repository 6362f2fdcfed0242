"""A page that looks on at a line which somebody else owns: what it is told, what it may, how it is answered."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest

from ruffini.errors import InputError, RefusedError
from ruffini.rig.guide import Guide
from ruffini.view.guided import AGAIN, GuidingPage, serving
from ruffini.view.lent_line import LentLine
from ruffini.view.outbox import Outbox
from ruffini.wire import Decoder, Frame, Schema, encode_message

SCHEMA = Schema.own()
NUMBER = SCHEMA.type_numbers
HELLO = SCHEMA.new("Hello", device_serial="7", protocol_version=1)


def sensor() -> Any:
    """As much of a `Connection` as is lent."""
    return SimpleNamespace(port="/dev/pts/7", schema=SCHEMA, hello=HELLO, raw_sink=None)


def asked(name: str, **fields: Any) -> bytes:
    payload = SCHEMA.new(name.title(), **fields).SerializeToString()
    return encode_message(NUMBER[name], payload, sensor=255, sequence=0)


class Page:
    """The other end of a WebSocket, without a browser."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.guides: list[dict[str, Any]] = []
        self._decoder, self._n_seen = Decoder(), 0

    async def __aenter__(self) -> Page:
        self._session = aiohttp.ClientSession()
        self.socket = await self._session.ws_connect(f"{self.address}line/0")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._session.close()

    async def frames(self) -> list[Frame]:
        """What comes next; empty where the server has gone."""
        async for message in self.socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                self._n_seen += 1
                await self.socket.send_json({"seen": self._n_seen})
                return list(self._decoder.feed(message.data))
            told = json.loads(message.data)
            if told["kind"] == "guide":
                self.guides.append(told)
        return []

    async def answer(self, data: bytes) -> Any:
        await self.socket.send_bytes(data)
        while not (frames := await self.frames()):
            pass
        return SCHEMA.decode(frames[0].type, frames[0].payload)


def test_a_page_gets_the_owners_frames_and_may_change_nothing() -> None:
    owner = sensor()

    async def look_on(address: str) -> list[Any]:
        async with Page(address) as page:
            said: list[Any] = [await page.answer(asked("HELLO")), await page.answer(asked("SCHEMA"))]
            subscriptions = [{"type": NUMBER["WRENCH"], "every": 1}]
            said.append(await page.answer(asked("COMMAND", request_id=5, subscribe={"subscriptions": subscriptions})))
            said.append(await page.answer(asked("COMMAND", request_id=6, zero={})))
            for name in ("REPLY", "HELLO", "TIME", "WRENCH"):  # what the owner asked for is not for a page
                owner.raw_sink(encode_message(NUMBER[name], b"", sensor=0, sequence=3, flags=2))
            said.append([f.type for f in await page.frames()])
            return said

    line = LentLine(owner, lambda: {}, lambda word, number, typed: None)
    told = list[str]()
    with serving([line], 0, told.append):
        hello, schema, subscribed, refused, types = asyncio.run(asyncio.wait_for(look_on(told[0]), 60))
    assert hello == HELLO
    assert schema.file_descriptor_set == SCHEMA.bytes
    assert (subscribed.request_id, subscribed.code) == (5, 0)
    assert (refused.request_id, refused.code) == (6, SCHEMA.enum_number("ReplyCode", "REPLY_BUSY"))
    assert "only looks on" in refused.text
    assert types == [NUMBER["WRENCH"]]
    assert owner.raw_sink is None  # given back


@pytest.mark.parametrize(
    "said", ['{"guide": 7}', '{"guide": "done", "asked": "1"}', '{"guide": {"a": 1}}', "[]", '"guide"', "{", "{}"]
)
def test_what_a_page_says_and_means_nothing_is_passed_over(said: str) -> None:
    heard: list[str] = []

    async def say(address: str) -> Any:
        async with Page(address) as page:
            await page.socket.send_str(said)
            return await page.answer(asked("HELLO"))

    told = list[str]()
    with serving([LentLine(sensor(), lambda: {}, lambda word, *_: heard.append(word))], 0, told.append):
        assert asyncio.run(asyncio.wait_for(say(told[0]), 60)) == HELLO
    assert heard == []


@pytest.mark.parametrize(
    ("error", "end"),
    [
        (None, {"ok": True, "text": "All touches are collected.", "next": "ruffini cal fit"}),
        (
            RefusedError("the reference is saturated"),
            {"ok": False, "text": "the reference is saturated", "next": AGAIN},
        ),
    ],
)
def test_how_it_ended_and_what_is_next_is_told_before_the_line_goes(
    error: Exception | None, end: dict[str, Any]
) -> None:
    address, is_seen = list[str](), threading.Event()
    page = GuidingPage("free on tiny", "ruffini cal fit", 0, address.append)

    async def look_on() -> list[dict[str, Any]]:
        async with Page(address[0]) as onlooker:
            while not onlooker.guides:
                await onlooker.answer(asked("HELLO"))
            is_seen.set()
            while await onlooker.frames():
                pass
            return onlooker.guides

    with ThreadPoolExecutor(1) as pool:
        with contextlib.suppress(RefusedError), page.shown(sensor()):
            looking = pool.submit(asyncio.run, look_on())
            assert is_seen.wait(60)
            if error:
                raise error
        guides = looking.result(60)
    assert guides[0]["end"] is None
    assert guides[-1]["end"] == end
    assert guides[-1]["program"] == "free on tiny"


def test_a_questions_answer_counts_once_and_only_for_it() -> None:
    page = GuidingPage("weights on tiny", "ruffini cal fit", 0, lambda _: None)
    guide: Guide = page.guide
    guide.n_asked, guide.is_asked = 2, True
    page._hear("done", 1, "")
    assert guide.is_asked
    page._hear("done", 2, "")
    assert not guide.is_asked
    page._hear("done", 2, "")
    page.keys.guard()  # one Enter lay there, and no more
    page._hear("stop", 0, "")
    with pytest.raises(RefusedError):
        page.keys.guard()
    page.keys.close()


def test_a_taken_http_port_is_said() -> None:
    told = list[str]()
    with serving([LentLine(sensor(), lambda: {}, lambda word, number, typed: None)], 0, told.append):
        port = int(told[0].rstrip("/").rsplit(":", 1)[1])
        page = GuidingPage("free on tiny", "", port, lambda _: None)
        with pytest.raises(InputError, match="is taken"), page.shown(sensor()):
            pass


def test_a_stream_that_goes_on_does_not_keep_the_last_word_from_a_page() -> None:
    async def leave() -> list[str]:
        owner = sensor()
        line, box = LentLine(owner, lambda: {"end": "complete"}, lambda *_: None), Outbox()
        await line.start()
        await asyncio.sleep(0)
        line.boxes[box] = {}
        wrench = encode_message(NUMBER["WRENCH"], b"", sensor=0, sequence=3, flags=2)

        async def stream() -> None:
            while (sink := owner.raw_sink) is not None:
                sink(wrench)
                await asyncio.sleep(0)

        streaming = asyncio.create_task(stream())
        leaving = asyncio.create_task(line.say_goodbye())
        texts: list[str] = []
        while not leaving.done():
            if not box.is_empty:
                texts += (await box.take())[0]
            await asyncio.sleep(0)
        await asyncio.wait_for(streaming, 60)
        await line.close()
        return texts

    assert json.loads(asyncio.run(leave())[0])["end"] == "complete"
