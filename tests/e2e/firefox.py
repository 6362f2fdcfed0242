"""Debian's Firefox, by WebDriver BiDi: another browser than Chromium."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import count
from typing import Any

import aiohttp
from hang import HANG_S

FIREFOX = "/usr/bin/firefox-esr"
LISTENS = re.compile(r"WebDriver BiDi listening on (ws://\S+)")


class FirefoxPage:
    """One page. Scripts' faults are kept in `faults`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._loop, self._socket, self._numbers = loop, socket, count(1)
        self.faults: list[str] = []
        self._command("session.new", capabilities={})
        self._command("session.subscribe", events=["log.entryAdded"])
        self._context = self._command("browsingContext.create", type="tab")["context"]

    def goto(self, address: str) -> None:
        self._command("browsingContext.navigate", context=self._context, url=address, wait="complete")

    def run_before_scripts(self, function: str) -> None:
        """Of every page from now on."""
        self._command("script.addPreloadScript", functionDeclaration=function)

    def evaluate(self, expression: str) -> Any:
        """What it is, through JSON."""
        told = self._command(
            "script.evaluate", expression=f"JSON.stringify({expression} ?? null)",
            target={"context": self._context}, awaitPromise=True,
        )  # fmt: skip
        if told["type"] != "success":
            raise AssertionError(f"{expression}: {told['exceptionDetails']['text']}")
        return json.loads(told["result"]["value"])

    def _command(self, method: str, **params: Any) -> Any:
        return self._loop.run_until_complete(asyncio.wait_for(self._ask(method, params), HANG_S))

    async def _ask(self, method: str, params: dict[str, Any]) -> Any:
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": params})
        while True:
            told = await self._socket.receive_json()
            if told.get("method") == "log.entryAdded" and told["params"]["level"] == "error":
                self.faults.append(str(told["params"]["text"]))
            if told.get("id") == number:
                if told["type"] == "error":
                    raise AssertionError(f"{method}: {told['message']}")
                return told["result"]


@contextlib.contextmanager
def firefox() -> Iterator[FirefoxPage]:
    """One page of a fresh profile; `make test` installs the browser."""
    with tempfile.TemporaryDirectory() as profile, asyncio.Runner() as runner:
        command = [FIREFOX, "--headless", "--no-remote", "--profile", profile, "--remote-debugging-port", "0"]
        pipes: dict[str, Any] = {"stderr": subprocess.PIPE, "stdout": subprocess.DEVNULL, "text": True}
        with subprocess.Popen(command, env={**os.environ, "HOME": profile}, **pipes) as process:
            assert process.stderr is not None
            try:
                found = next(filter(None, map(LISTENS.search, process.stderr)), None)
                assert found, "Firefox ended"
                session = runner.run(_session())
                socket = runner.run(_connected(session, f"{found[1]}/session"))
                yield FirefoxPage(runner.get_loop(), socket)
                runner.run(session.close())
            finally:
                process.kill()


async def _session() -> aiohttp.ClientSession:
    return aiohttp.ClientSession()


async def _connected(session: aiohttp.ClientSession, address: str) -> aiohttp.ClientWebSocketResponse:
    return await session.ws_connect(address, max_msg_size=0)
