"""The viewer answers this computer's own page only, whatever a request says of its host."""

from __future__ import annotations

import asyncio

import pytest
from aiohttp import web

from ruffini.view import server


async def status_of(request: bytes) -> int:
    """Status code that the middleware gives to a raw request for /lines.json."""
    app = web.Application(middlewares=[server._only_from_here])
    app[server.LINES] = []
    app.router.add_get("/lines.json", server._lines)
    runner = server.make_runner(app)
    await runner.setup()
    try:
        await web.TCPSite(runner, server.HOST, 0).start()
        port = runner.addresses[0][1]
        reader, writer = await asyncio.open_connection(server.HOST, port)
        writer.write(request.replace(b"PORT", b"%d" % port))
        answer = await asyncio.wait_for(reader.readline(), 120)  # a guard against a hang
        writer.close()
    finally:
        await runner.cleanup()
    return int(answer.split()[1])


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"GET /lines.json HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\n\r\n", 200),
        (b"GET /lines.json HTTP/1.1\r\nHost: localhost:PORT\r\nOrigin: http://localhost:PORT\r\n\r\n", 200),
        (b"GET /lines.json HTTP/1.1\r\nHost: [\r\n\r\n", 403),
        (b"GET /lines.json HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://[\r\n\r\n", 403),
        (b"GET /lines.json HTTP/1.1\r\nHost: evil.example\r\n\r\n", 403),
        (b"GET /lines.json HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\nOrigin: http://evil.example\r\n\r\n", 403),
        (b"GET /lines.json HTTP/1.0\r\n\r\n", 403),
        (b"GET /lines.json HTTP/1.1\r\n\r\n", 400),
        (b"GET /lines.json HTTP/1.1\r\nHost: \x7f\r\n\r\n", 400),
        (b"\x16\x03\x01\x02\x00\r\n\r\n", 400),
    ],
)
def test_only_this_computers_page_is_answered(
    request_bytes: bytes, status: int, caplog: pytest.LogCaptureFixture
) -> None:
    assert asyncio.run(status_of(request_bytes)) == status
    assert not caplog.records, "a person's terminal shows no traceback of a stranger's request"
