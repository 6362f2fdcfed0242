"""The reading thread of a sensor: whoever still asks at its end is told, once; so is what was left out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from ruffini.api.sensor import Sensor
from ruffini.device.backlog import Backlog
from ruffini.errors import NoDeviceError
from ruffini.wire import Frame, Schema


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


class BusyConnection(GoneConnection):
    """Of which two messages come, and in between more than may wait for a command's reply."""

    def __init__(self) -> None:
        self.messages = Backlog(max_messages=2)

    def stream(self, **_: Any) -> Iterator[Any]:
        status = self.schema.new("Status")
        packet = Frame(self.schema.type_numbers["STATUS"], 255, 0, 0, b"")
        yield packet, status
        for _ in range(5):
            self.messages.append(packet, status)
        yield packet, status
        yield packet, status


def test_what_was_left_out_while_a_command_waited_is_said_once() -> None:
    notes: list[str] = []
    sensor = Sensor(BusyConnection(), {}, on_note=notes.append)  # type: ignore[arg-type]
    sensor.close()
    assert sensor.n_left_out == 3
    assert notes == ["/dev/gone: 3 messages were dropped: too many arrived while a command waited for its reply"]
