"""The end of a sensor that several threads use: whoever still asks is told, once, by whichever thread sees it first."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from ruffini.api.sensor import Sensor
from ruffini.errors import NoDeviceError
from ruffini.wire import Schema


class GoneConnection:
    """A sensor whose line ends at once."""

    port, serial_number, schema = "/dev/gone", "0001", Schema.own()
    hello = SimpleNamespace(sensors=[SimpleNamespace(sensor=0, board="b")])

    def read_clock(self) -> None: ...
    def close(self) -> None: ...
    def stream(self, **_: Any) -> Iterator[Any]:
        return iter(())


class TakenBetween(deque[Any]):
    """Of which another thread takes first, once, whenever somebody takes."""

    other: Callable[[], None] = staticmethod(lambda: None)

    def popleft(self) -> Any:
        other, self.other = self.other, lambda: None
        other()
        return super().popleft()


def test_what_is_asked_as_the_reader_ends_is_refused_by_whoever_takes_it() -> None:
    sensor = Sensor(GoneConnection(), {})  # type: ignore[arg-type]
    sensor.close()
    asked = TakenBetween()
    sensor._asked = asked
    asked.other = sensor._refuse_asked  # as the reading thread does at its end
    with pytest.raises(NoDeviceError, match="/dev/gone is closed"):
        sensor.call(lambda _: 1)
