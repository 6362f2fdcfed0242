"""A stream under watch: frames, contacts and temperatures as they arrive, from a sensor that is scripted."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest
from hang import until

from ruffini.boards import find_board
from ruffini.rig import stream_watch
from ruffini.rig.session import Pace, watched_stream
from ruffini.rig.stream_watch import StreamWatch, Window
from ruffini.wire import Schema


class Scripted:
    """Sends what it is given, once."""

    def __init__(self, *messages: tuple[str, dict]) -> None:
        self.schema, self.port, self.asked = Schema.own(), "script", {}
        self._left = [
            (SimpleNamespace(type=self.schema.type_numbers[name.upper()]), self.schema.new(name, **values))
            for name, values in messages
        ]

    def subscribe(self, **every: int) -> None:
        self.asked = every

    def stream(self, *, timeout_s: float):
        while self._left:
            yield self._left.pop(0)
        time.sleep(timeout_s)


def wait_for(condition) -> None:
    until(condition, "what the sensor sends")


WARM = {"temperatures": [{"place": "gel", "milli_celsius": 23_450}, {"place": "lamp", "milli_celsius": -1_500}]}


def test_contacts_come_beside_their_frame():
    contact = {"id": 1, "center_x_um": 2000, "force_z_un": -1_000_000, "validity": 1}
    sensor = Scripted(
        ("Wrench", {"stamp": {"capture_us": 5_000_000}, "force_z_un": -1_000_000, "validity": [0, 0, 1, 0, 0, 0]}),
        ("Contacts", {"stamp": {"capture_us": 5_000_000}, "contacts": [contact, {**contact, "id": 2}]}),
        ("Contacts", {"stamp": {"capture_us": 6_000_000}}),
    )
    with StreamWatch(sensor, field_every=0, contact_every=1) as watch:
        wait_for(lambda: len(watch.since(0).contacts) == 2)
        window = watch.since(0)
        assert sensor.asked["contacts"] == 1
        assert [c.number for c in window.contacts] == [1, 2]
        assert window.contacts[0].stream_s == window.frames[0].stream_s == 5.0
        assert watch.force()[2] == pytest.approx(-1.0)
        assert window.between(5.5, 7).contacts == []
        assert [len(kind) for kind in watch.take()] == [len(kind) for kind in window]
        assert watch.take() == Window([], [], [], [], [], [])


def test_temperatures_are_those_that_the_device_says_now(monkeypatch):
    sensor = Scripted(("Status", WARM))
    with StreamWatch(sensor) as watch:
        wait_for(watch.temperatures)
        assert sensor.asked["status"] == 1
        assert watch.temperatures() == pytest.approx({"gel": 23.45, "lamp": -1.5})
        monkeypatch.setattr(stream_watch, "WARM_S", 0.0)
        assert watch.temperatures() == {}


def test_a_device_that_says_no_temperature_has_none():
    sensor = Scripted(("Status", {}), ("Wrench", {"stamp": {"capture_us": 1}}))
    with StreamWatch(sensor) as watch:
        wait_for(lambda: watch.since(0).frames)
        assert watch.temperatures() == {}


def test_what_arrived_long_ago_is_freed(monkeypatch):
    monkeypatch.setattr(stream_watch, "KEPT_S", 10.0)
    monkeypatch.setattr(stream_watch.host_clock, "now", iter([5.0, 14.9, 15.1, *[16.0] * 1000]).__next__)
    sensor = Scripted(*(("Wrench", {"stamp": {"capture_us": i, "frame": i}}) for i in (1, 2, 3)))
    with StreamWatch(sensor) as watch:
        wait_for(lambda: 3 in [f.frame for f in watch.since(0).frames])
        assert [f.frame for f in watch.since(0).frames] == [2, 3]
        watch.forget(14.9)
        assert [f.frame for f in watch.since(0).frames] == [3]


@pytest.mark.parametrize(("board", "is_bad"), [("gelslim", True), ("ftouch", False), ("digit-tactile", False)])
def test_a_touch_beyond_a_calibration_extends_it(board: str, is_bad: bool) -> None:
    """Over range is a bound of the gel only where displacements are measured."""
    sensor: Any = Scripted(("Wrench", {"stamp": {"capture_us": 1}, "validity": [1] * 6}))
    sensor.hello = SimpleNamespace(sensors=[SimpleNamespace(board=board)], session_id=1)
    with watched_stream(sensor, find_board(board), Pace()) as watched:
        said = set(watched.bad_flags.values())
    assert ("over_range" in said) is is_bad
    assert said >= {"no_reference", "markers_lost", "saturated", "dark", "overexposed"}
