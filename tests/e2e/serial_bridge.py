"""What stands in for a browser's serial port: `navigator.serial` in the page, a WebSocket to here, a pty."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

from aiohttp import WSMsgType, web

# A port as WebSerial has it: opened, read and written by streams, gone with an error when it is unplugged; it is not
# opened twice, and not closed while somebody holds its streams. `window.__isBusy`: another program has it.
FAKE_SERIAL = """
(() => {
  class FakePort extends EventTarget {
    async open({ baudRate, bufferSize }) {
      if (this.readable) throw new DOMException("The port is already open.", "InvalidStateError");
      if (window.__isBusy) throw new DOMException("Failed to open serial port.", "NetworkError");
      window.__opened = { baudRate, bufferSize };
      const socket = new WebSocket("ws://127.0.0.1:PORT/line");
      socket.binaryType = "arraybuffer";
      await new Promise((resolve, reject) => {
        socket.onopen = resolve;
        socket.onerror = () => reject(new Error("no port"));
      });
      this.readable = new ReadableStream({
        start: (controller) => {
          const isOver = () => this.isCancelled;
          this.isCancelled = false;
          socket.onmessage = ({ data }) => isOver() || controller.enqueue(new Uint8Array(data));
          socket.onclose = () => isOver() || controller.error(new Error("The device has been lost."));
        },
        cancel: () => {
          this.isCancelled = true;
        },
      });
      this.writable = new WritableStream({ write: (chunk) => socket.send(chunk) });
      this.socket = socket;
    }
    async close() {
      if (!this.readable) throw new DOMException("The port is already closed.", "InvalidStateError");
      if (this.readable.locked || this.writable.locked) throw new TypeError("Cannot cancel a locked stream");
      this.socket.close();
      this.readable = this.writable = null;
    }
  }
  const serial = new EventTarget();
  const port = new FakePort();
  serial.requestPort = async () => port;
  window.__plugIn = () => serial.dispatchEvent(Object.assign(new Event("connect"), { port }));
  Object.defineProperty(navigator, "serial", { value: serial });
})();
"""


class SerialBridge:
    """Bytes between a WebSocket and a device's pty; `noise` goes before the first byte of the device."""

    def __init__(self, device_port: str, noise: bytes = b"") -> None:
        self._device_port, self._noise = device_port, noise
        self._sockets: list[web.WebSocketResponse] = []
        self.port = 0
        self.loop = asyncio.new_event_loop()

    async def serve(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        self._sockets.append(socket)
        end = os.open(self._device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(end)
        arrived: asyncio.Queue[bytes] = asyncio.Queue()
        arrived.put_nowait(self._noise)

        def read() -> None:
            with contextlib.suppress(BlockingIOError, OSError):
                arrived.put_nowait(os.read(end, 65_536))

        async def send() -> None:
            while True:
                await socket.send_bytes(await arrived.get())

        self.loop.add_reader(end, read)
        sending = asyncio.create_task(send())
        try:
            async for message in socket:
                if message.type is WSMsgType.BINARY:
                    os.write(end, message.data)
        finally:
            sending.cancel()
            self.loop.remove_reader(end)
            os.close(end)
        return socket

    def unplug(self) -> None:
        """The device is gone; it may be opened again."""
        for socket in self._sockets:
            asyncio.run_coroutine_threadsafe(socket.close(), self.loop).result(5)
        self._sockets.clear()


@contextlib.contextmanager
def serial_bridge(device_port: str, page_folder: Path, noise: bytes = b"") -> Iterator[SerialBridge]:
    """The bridge, and beside it the page as any static host would serve it."""
    bridge = SerialBridge(device_port, noise)

    async def index(_: web.Request) -> web.FileResponse:
        return web.FileResponse(page_folder / "index.html")

    async def start() -> web.AppRunner:
        app = web.Application()
        app.router.add_get("/line", bridge.serve)
        app.router.add_get("/", index)
        app.router.add_static("/", page_folder)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        bridge.port = runner.addresses[0][1]
        return runner

    runner = bridge.loop.run_until_complete(start())
    thread = threading.Thread(target=bridge.loop.run_forever, daemon=True)
    thread.start()
    try:
        yield bridge
    finally:
        asyncio.run_coroutine_threadsafe(runner.cleanup(), bridge.loop).result(10)
        bridge.loop.call_soon_threadsafe(bridge.loop.stop)
        thread.join(10)
        bridge.loop.close()
