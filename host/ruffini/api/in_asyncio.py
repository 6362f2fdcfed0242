"""The same sensor for asyncio programs: a thread reads the line, so the event loop never blocks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from ruffini.api.frame import SensorFrame
from ruffini.api.frames import Frames
from ruffini.api.sensor import Sensor, connect
from ruffini.device.connection import Connection
from ruffini.errors import NoDeviceError

T = TypeVar("T")


class AsyncFrames:
    """`Frames` for `async for`, in the event loop that created it."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._loop, self._changed = asyncio.get_running_loop(), asyncio.Event()
        frames.wake = self._wake

    def _wake(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._changed.set)
        except RuntimeError:  # the loop has ended
            self._frames.wake = lambda: None

    @property
    def n_replaced(self) -> int:
        """Frames replaced by a newer one before they were taken."""
        return self._frames.n_replaced

    def __aiter__(self) -> AsyncFrames:
        return self

    async def __anext__(self) -> SensorFrame:
        while True:
            self._changed.clear()
            try:
                frame = self._frames.get(0)
            except StopIteration:
                raise StopAsyncIteration from None
            if frame is not None:
                return frame
            await self._changed.wait()


class AsyncSensor:
    """`async with ruffini.connect_async() as sensor`; see `Sensor`."""

    def __init__(self, arguments: dict[str, Any]) -> None:
        self._arguments = arguments
        self._sensor: Sensor | None = None

    async def __aenter__(self) -> AsyncSensor:
        self._sensor = await asyncio.to_thread(lambda: connect(**self._arguments))
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.to_thread(self.sensor.close)

    @property
    def sensor(self) -> Sensor:
        """The underlying `Sensor`, for everything that does not block: serial_number, boards, health, nodes()."""
        if self._sensor is None:
            raise NoDeviceError("not connected yet: use `async with ruffini.connect_async(...) as sensor`")
        return self._sensor

    def frames(self, *, newest: bool = False, sensor: int | None = None, partial: bool = False) -> AsyncFrames:
        """As `Sensor.frames`, for `async for`."""
        return AsyncFrames(self.sensor.frames(newest=newest, sensor=sensor, partial=partial))

    async def read(self) -> SensorFrame:
        """The next frame."""
        return await anext(self.frames(newest=True))

    async def zero(self, *, even_if_touched: bool = False) -> None:
        """As `Sensor.zero`."""
        await asyncio.to_thread(lambda: self.sensor.zero(even_if_touched=even_if_touched))

    async def call(self, action: Callable[[Connection], T]) -> T:
        """As `Sensor.call`."""
        return await asyncio.to_thread(self.sensor.call, action)


def connect_async(port: str | None = None, serial: str | None = None, **options: Any) -> AsyncSensor:
    """As `ruffini.connect`, with the same options, for `async with`."""
    return AsyncSensor({"port": port, "serial": serial, **options})
