"""`ruffini view`: the page, and a WebSocket for each sensor's line, on this computer alone.

A WebSocket carries the device's frames as they are in proto/README.md, in binary messages; the page's commands come
back alike. Text messages are JSON of the server's own: {"kind": "line"} says whether the line is open,
{"kind": "health"} what came over it, {"kind": "guide"} what a collection is at that has the page beside it
(rig/guide.py), or at which step a calibration from the page is (view/steps.py). The page answers each binary message
with {"seen": n}, its number; a collection's question of number n with {"guide": "done", "asked": n, "typed": "203"}, or
"stop" at any time; step n of a calibration with {"calibrate": WORD, "step": n, "fields": {...}}. No more than two
binary messages are on their way at a time: what is newer than those waits here, and the newest replaces what is older.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError

from ruffini.errors import InputError, NoDeviceError, RuffiniError
from ruffini.native import native_folder
from ruffini.patience import PATIENCE
from ruffini.view.line import Line
from ruffini.view.outbox import Outbox
from ruffini.wire import Decoder

HOST = "127.0.0.1"
IN_FLIGHT = 2  # binary messages that the page has not seen yet
MAX_COMMAND_BYTES = 8192  # two frames
HEARTBEAT_S = 10 * PATIENCE  # a page that does not answer within half of it is gone
# Nothing from elsewhere, neither scripts nor pictures.
POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; connect-src 'self' "
    "ws://127.0.0.1:* ws://localhost:*; worker-src 'self'; frame-ancestors 'none'; base-uri 'none'"
)
# A report is shown inside the page: pictures of its own, no script.
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; sandbox"
LINES: web.AppKey[list[Line]] = web.AppKey("lines", list[Line])


def page_folder() -> Path:
    """Where the built page is.

    Raises
    ------
    RuffiniError
        It was not built.
    """
    folder = native_folder() / "page"
    if not (folder / "index.html").is_file():
        raise RuffiniError(f"{folder}: the page was not built: run `make build`")
    return folder


@web.middleware
async def _only_from_here(request: web.Request, handler: Any) -> web.StreamResponse:
    """Another site's page must not talk to a sensor through the browser of who visits it."""
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    try:
        is_ours = urlsplit(f"//{host}").hostname in (HOST, "localhost")
        is_ours = is_ours and (not origin or urlsplit(origin).netloc == host)
    except ValueError:  # e.g. "Host: ["
        is_ours = False
    if not is_ours:
        raise web.HTTPForbidden(text="the viewer answers its own page alone")
    response: web.StreamResponse = await handler(request)
    if not response.prepared:
        response.headers.setdefault("Content-Security-Policy", POLICY)
        response.headers["Cache-Control"] = "no-cache"
    return response


async def _index(_: web.Request) -> web.FileResponse:
    return web.FileResponse(page_folder() / "index.html")


async def _lines(request: web.Request) -> web.Response:
    lines = request.app[LINES]
    return web.json_response(
        [{"id": i, "port": line.port, "calibrates": line.calibrates} for i, line in enumerate(lines)]
    )


async def _report(request: web.Request) -> web.FileResponse:
    lines, number = request.app[LINES], int(request.match_info["line"])
    path = lines[number].report if number < len(lines) else None
    if path is None or not path.is_file():
        raise web.HTTPNotFound(text="there is no report yet")
    return web.FileResponse(path, headers={"Content-Security-Policy": REPORT_POLICY})


async def _socket(request: web.Request) -> web.WebSocketResponse:
    lines = request.app[LINES]
    number = int(request.match_info["line"])
    if number >= len(lines):
        raise web.HTTPNotFound(text=f"there is no line {number}")
    socket = web.WebSocketResponse(heartbeat=HEARTBEAT_S, max_msg_size=MAX_COMMAND_BYTES, compress=False)
    await socket.prepare(request)
    line, box, seen = lines[number], Outbox(), asyncio.Semaphore(IN_FLIGHT)
    line.boxes[box] = {}
    box.put_text("line", line.state())
    sender = asyncio.create_task(_send_all(socket, box, seen))
    try:
        await _receive_all(socket, line, box, seen)
    finally:
        sender.cancel()
        await line.leave(box)
    return socket


async def _send_all(socket: web.WebSocketResponse, box: Outbox, seen: asyncio.Semaphore) -> None:
    with contextlib.suppress(ConnectionError):
        while True:
            await seen.acquire()
            texts, data = await box.take()
            for text in texts:
                await socket.send_str(text)
            if data:
                await socket.send_bytes(data)
            else:
                seen.release()


async def _receive_all(socket: web.WebSocketResponse, line: Line, box: Outbox, seen: asyncio.Semaphore) -> None:
    decoder, n_seen = Decoder(from_host=True), 0
    async for message in socket:
        if message.type is WSMsgType.BINARY:
            for frame in decoder.feed(message.data):
                await line.send(box, frame)
        elif message.type is WSMsgType.TEXT:
            with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
                told = json.loads(message.data)
                if not isinstance(told, dict):
                    continue
                if "guide" in told or "calibrate" in told:
                    line.hear(told)
                # One at a time: a page cannot ask for more than is its due.
                elif told["seen"] == n_seen + 1:
                    n_seen += 1
                    seen.release()


def make_app(lines: Sequence[Line], on_note: Callable[[str], None] = lambda _: None) -> web.Application:
    """Routes and lines; the lines are opened when it starts and closed when it ends.

    Of several a line that is missing or busy is left out and told.
    """
    app = web.Application(middlewares=[_only_from_here])
    app[LINES] = list(lines)
    app.router.add_get("/", _index)
    app.router.add_get("/lines.json", _lines)
    app.router.add_get(r"/line/{line:\d{1,3}}", _socket)
    app.router.add_get(r"/report/{line:\d{1,3}}", _report)
    app.router.add_static("/", page_folder())

    async def hold_lines(_: web.Application) -> Any:
        app[LINES].clear()
        problems = []
        async with contextlib.AsyncExitStack() as stack:
            for line in lines:
                try:
                    await line.start()
                except NoDeviceError as error:
                    problems.append(str(error))
                    continue
                stack.push_async_callback(line.close)
                app[LINES].append(line)
            if problems and not app[LINES]:
                raise NoDeviceError("; ".join(problems))
            for problem in problems:
                on_note(f"{problem}; the page shows the others")
            health = [asyncio.create_task(line.tell_health()) for line in app[LINES]]
            yield
            for task in health:
                task.cancel()

    app.cleanup_ctx.append(hold_lines)
    return app


def _is_ours(record: logging.LogRecord) -> bool:
    """A request that is no HTTP is answered with 400; it is no error of the server to print."""
    return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


def make_runner(app: web.Application) -> web.AppRunner:
    """What runs the app."""
    logger = logging.getLogger("ruffini.view")
    logger.addFilter(_is_ours)
    return web.AppRunner(app, access_log=None, logger=logger, shutdown_timeout=1)


async def serve(
    lines: Sequence[Line], http_port: int, ready: Callable[[str], None], stop: asyncio.Event,
    on_note: Callable[[str], None] = lambda _: None,
) -> None:  # fmt: skip
    """Serve the page until `stop`; `ready` gets its address. HTTP port 0: any that is free.

    `on_note` is told of serial ports that are missing or busy while there are others.

    Raises
    ------
    NoDeviceError
        All serial ports are missing or busy.
    InputError
        The HTTP port is taken.
    """
    app = make_app(lines, on_note)
    runner = make_runner(app)
    try:
        await runner.setup()
        site = web.TCPSite(runner, HOST, http_port)
        try:
            await site.start()
        except OSError as error:
            raise InputError(
                f"port {http_port} of {HOST} is taken ({error.strerror}): is another viewer running? "
                "Choose another one with --http-port, or 0 for any"
            ) from error
        ready(f"http://{HOST}:{runner.addresses[0][1]}/")
        await stop.wait()
        for line in app[LINES]:
            await line.say_goodbye()
    finally:
        await runner.cleanup()
